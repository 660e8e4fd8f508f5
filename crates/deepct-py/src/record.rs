//! What the objects of all classes can do: be compared, hashed, copied, pickled and shown. All of this
//! follows from the keyword arguments of their constructor.

use crate::view::Views;
use numpy::{PyUntypedArray, PyUntypedArrayMethods};
use pyo3::PyClass;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict, PyList, PyTuple};

/// Length above which the items of a list are not shown.
const SHOWN: usize = 12;

/// A class whose constructor takes all that its objects consist of.
pub(crate) trait Record: PyClass {
    /// The keyword arguments of the constructor that make an equal object.
    fn arguments<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>>;

    /// What is shown of an object.
    fn shown<'py>(of: &Bound<'py, Self>) -> PyResult<Bound<'py, PyDict>> {
        Self::arguments(of)
    }
}

/// The arguments that are attributes of the object with the same names; those that are None are
/// omitted.
pub(crate) fn attributes<'py>(
    of: &Bound<'py, PyAny>,
    names: &[&str],
) -> PyResult<Bound<'py, PyDict>> {
    let arguments = PyDict::new(of.py());
    for name in names {
        let value = of.getattr(*name)?;
        if !value.is_none() {
            arguments.set_item(name, value)?;
        }
    }
    Ok(arguments)
}

/// The argument that does not belong to the value of an object: where it comes from.
const ORIGIN: &str = "lineage";

/// The arguments that belong to the value of an object.
fn value<'py, T: Record>(of: &Bound<'py, T>) -> PyResult<Bound<'py, PyDict>> {
    without_origin(T::arguments(of)?)
}

fn without_origin(arguments: Bound<'_, PyDict>) -> PyResult<Bound<'_, PyDict>> {
    if arguments.contains(ORIGIN)? {
        arguments.del_item(ORIGIN)?;
    }
    Ok(arguments)
}

/// Gives the class of a [`Record`] the methods of Python that all classes have; with `@picture`, all but
/// the table that notebooks show; with `@volume`, also the page of a field in 3D below the table.
macro_rules! record {
    ($class:ty) => {
        $crate::record::record!(@picture $class);

        #[pymethods]
        impl $class {
            fn _repr_html_(slf: &Bound<'_, Self>) -> PyResult<String> {
                $crate::record::html(slf)
            }
        }
    };
    (@volume $class:ty) => {
        $crate::record::record!(@picture $class);

        #[pymethods]
        impl $class {
            fn _repr_html_(slf: &Bound<'_, Self>) -> PyResult<String> {
                Ok($crate::page::with_page(slf, $crate::record::html(slf)?))
            }
        }
    };
    (@picture $class:ty) => {
        #[pymethods]
        impl $class {
            fn __getnewargs_ex__<'py>(
                slf: &Bound<'py, Self>,
            ) -> PyResult<(Bound<'py, pyo3::types::PyTuple>, Bound<'py, pyo3::types::PyDict>)> {
                let arguments = <Self as $crate::record::Record>::arguments(slf)?;
                Ok((pyo3::types::PyTuple::empty(slf.py()), arguments))
            }

            fn __eq__(slf: &Bound<'_, Self>, other: &Bound<'_, PyAny>) -> PyResult<Py<PyAny>> {
                $crate::record::equal(slf, other)
            }

            fn __hash__(slf: &Bound<'_, Self>) -> PyResult<isize> {
                $crate::record::hash(slf)
            }

            fn __repr__(slf: &Bound<'_, Self>) -> PyResult<String> {
                $crate::record::text(slf)
            }
        }
    };
}
pub(crate) use record;

/// Whether two objects have the same class and equal arguments; `NotImplemented` for another class.
pub(crate) fn equal<T: Record>(
    one: &Bound<'_, T>,
    other: &Bound<'_, PyAny>,
) -> PyResult<Py<PyAny>> {
    let py = one.py();
    let other = match other.cast::<T>() {
        Ok(other) if other.as_any().get_type().is(one.as_any().get_type()) => other,
        _ => return Ok(py.NotImplemented()),
    };
    let (one, other) = (value(one)?, value(other)?);
    let mut same = one.len() == other.len();
    for (name, value) in one {
        same = same
            && match other.get_item(name)? {
                Some(found) => same_values(&value, &found)?,
                None => false,
            };
    }
    Ok(same.into_pyobject(py)?.to_owned().into_any().unbind())
}

fn same_values(one: &Bound<'_, PyAny>, other: &Bound<'_, PyAny>) -> PyResult<bool> {
    if let (Ok(one), Ok(other)) = (one.cast::<PyDict>(), other.cast::<PyDict>()) {
        let mut same = one.len() == other.len();
        for (name, value) in one {
            let found = other.get_item(name)?;
            same = same && found.map_or(Ok(false), |found| same_values(&value, &found))?;
        }
        return Ok(same);
    }
    if one.cast::<PyUntypedArray>().is_err() {
        return one.eq(other);
    }
    let options = PyDict::new(one.py());
    options.set_item("equal_nan", true)?;
    let numpy = one.py().import("numpy")?;
    numpy.call_method("array_equal", (one, other), Some(&options))?.extract()
}

/// A hash that is the same for equal objects. Arrays, whose values can be changed, contribute their
/// shape only, and dicts and lists of them nothing.
pub(crate) fn hash<T: Record>(of: &Bound<'_, T>) -> PyResult<isize> {
    let mut parts = vec![of.as_any().get_type().into_any()];
    for (name, value) in value(of)? {
        if has_dicts(&value) {
            continue;
        }
        parts.push(name);
        parts.push(if let Ok(array) = value.cast::<PyUntypedArray>() {
            PyTuple::new(of.py(), array.shape())?.into_any()
        } else if let Ok(list) = value.cast::<PyList>() {
            list.to_tuple().into_any()
        } else {
            value
        });
    }
    PyTuple::new(of.py(), parts)?.hash()
}

/// Whether an object is or contains dicts, as the history of an inversion.
fn has_dicts(object: &Bound<'_, PyAny>) -> bool {
    let items = object.cast::<PyList>();
    object.is_instance_of::<PyDict>()
        || items.is_ok_and(|list| list.iter().any(|item| has_dicts(&item)))
}

/// The object as the call that makes it, in which arrays are summarised.
pub(crate) fn text<T: Record>(of: &Bound<'_, T>) -> PyResult<String> {
    let name = of.as_any().get_type().name()?;
    let mut parts = Vec::new();
    for (argument, value) in without_origin(T::shown(of)?)? {
        parts.push(format!("{argument}={}", summary(&value)?));
    }
    let long = parts.iter().any(|part| part.contains(['\n', '<']));
    let indented = parts.iter().map(|part| format!("    {},\n", part.replace('\n', "\n    ")));
    Ok(match long {
        true => format!("{name}(\n{})", indented.collect::<String>()),
        false => format!("{name}({})", parts.join(", ")),
    })
}

/// The object as a table in HTML, which notebooks show.
pub(crate) fn html<T: Record>(of: &Bound<'_, T>) -> PyResult<String> {
    let mut rows = String::new();
    for (argument, value) in without_origin(T::shown(of)?)? {
        let text = summary(&value)?.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
        rows += &format!(
            "<tr><th style=\"text-align: left\">{argument}</th>\
             <td style=\"text-align: left\"><pre>{text}</pre></td></tr>"
        );
    }
    let name = of.as_any().get_type().name()?;
    Ok(format!("<table><caption>deepct_py.{name}</caption><tbody>{rows}</tbody></table>"))
}

fn summary(value: &Bound<'_, PyAny>) -> PyResult<String> {
    if let Ok(array) = value.cast::<PyUntypedArray>() {
        let is_mask = array.dtype().str()? == "bool";
        let contents = match (array.len(), is_mask) {
            (0, _) => String::new(),
            (_, true) => format!(", {} True", value.call_method0("sum")?),
            (_, false) => {
                // Values that are not numbers are passed over; there may be no others.
                let numpy = value.py().import("numpy")?;
                let end =
                    |name| numpy.getattr(name)?.call_method1("reduce", (value, value.py().None()));
                format!(", {} to {}", end("fmin")?, end("fmax")?)
            }
        };
        return Ok(format!("<{} {:?}{contents}>", array.dtype().str()?, array.shape()));
    }
    if value.is_instance_of::<Views>() {
        return Ok(format!("<Views of {}>", value.len()?));
    }
    if let Ok(bytes) = value.cast::<PyBytes>() {
        return Ok(format!("<{} bytes>", bytes.as_bytes().len()));
    }
    if let Ok(dict) = value.cast::<PyDict>() {
        let items =
            dict.iter().map(|(name, item)| Ok(format!("{}: {}", name.repr()?, summary(&item)?)));
        return Ok(format!("{{{}}}", items.collect::<PyResult<Vec<_>>>()?.join(", ")));
    }
    let Ok(list) = value.cast::<PyList>() else { return Ok(value.repr()?.to_string()) };
    if has_dicts(list.as_any()) || list.is_empty() {
        return Ok(format!("<list of {}>", list.len()));
    }
    let mut items = Vec::new();
    for item in list.iter().take(SHOWN) {
        items.push(summary(&item)?);
    }
    if list.len() > SHOWN {
        items.push(format!("<{} more>", list.len() - SHOWN));
    }
    let long = items.iter().any(|item| item.len() > SHOWN);
    Ok(if long {
        format!("[\n    {},\n]", items.join(",\n    "))
    } else {
        format!("[{}]", items.join(", "))
    })
}
