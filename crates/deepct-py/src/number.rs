//! Numbers given as arguments: of any type of Python and NumPy, alone or in any sequence.

use pyo3::exceptions::{PyOverflowError, PyTypeError, PyValueError};
use pyo3::prelude::*;

/// A whole number.
///
/// # Errors
/// `ValueError` if the number is negative or too large for its type, `TypeError` if `object` is not a
/// whole number; both name the argument.
pub(crate) fn whole<'py, T>(object: &Bound<'py, PyAny>, name: &str) -> PyResult<T>
where
    T: for<'a> FromPyObject<'a, 'py, Error = PyErr> + std::fmt::Display + Limits,
{
    object.extract().map_err(|problem: PyErr| {
        let py = object.py();
        let number = object.str().map_or_else(|_| "?".into(), |text| text.to_string());
        if problem.is_instance_of::<PyOverflowError>(py) {
            let range = format!("from {} to {}", T::LEAST, T::MOST);
            return PyValueError::new_err(format!("{name} is {number}, but must be {range}"));
        }
        PyTypeError::new_err(format!("{name} is {number}, but must be a whole number"))
    })
}

/// As [`whole`], for an argument that may be missing.
pub(crate) fn whole_if_given<'py, T>(
    object: Option<&Bound<'py, PyAny>>,
    name: &str,
) -> PyResult<Option<T>>
where
    T: for<'a> FromPyObject<'a, 'py, Error = PyErr> + std::fmt::Display + Limits,
{
    object.map(|object| whole(object, name)).transpose()
}

/// The range of a type of whole numbers.
pub(crate) trait Limits {
    const LEAST: i128;
    const MOST: i128;
}

macro_rules! limits {
    ($($kind:ty),*) => {
        $(impl Limits for $kind {
            const LEAST: i128 = <$kind>::MIN as i128;
            const MOST: i128 = <$kind>::MAX as i128;
        })*
    };
}
limits!(u32, u64, usize, i32);

/// As many whole numbers of 0 and more as there are `axes`, from a tuple, a list or an array.
///
/// # Errors
/// As [`whole`]; `ValueError` if there are more or fewer of them.
pub(crate) fn sizes<const N: usize>(
    object: &Bound<'_, PyAny>,
    name: &str,
    axes: [&str; N],
) -> PyResult<[usize; N]> {
    let items = items(object, name, axes)?;
    let mut numbers = [0; N];
    for ((number, item), axis) in numbers.iter_mut().zip(&items).zip(axes) {
        *number = whole(item, &format!("{name} ({axis})"))?;
    }
    Ok(numbers)
}

/// As many numbers as there are `axes`, from a tuple, a list or an array.
///
/// # Errors
/// `ValueError` if there are more or fewer of them, `TypeError` if one is not a number.
pub(crate) fn reals<const N: usize>(
    object: &Bound<'_, PyAny>,
    name: &str,
    axes: [&str; N],
) -> PyResult<[f64; N]> {
    let items = items(object, name, axes)?;
    let mut numbers = [0.0; N];
    for ((number, item), axis) in numbers.iter_mut().zip(&items).zip(axes) {
        *number = item.extract().map_err(|_| {
            PyTypeError::new_err(format!("{name} ({axis}) is {item}, but must be a number"))
        })?;
    }
    Ok(numbers)
}

/// A point or a vector x, y, z.
///
/// # Errors
/// As [`reals`].
pub(crate) fn point(object: &Bound<'_, PyAny>, name: &str) -> PyResult<deepct_core::math::DVec3> {
    reals(object, name, ["x", "y", "z"]).map(Into::into)
}

fn items<'py, const N: usize>(
    object: &Bound<'py, PyAny>,
    name: &str,
    axes: [&str; N],
) -> PyResult<Vec<Bound<'py, PyAny>>> {
    let wanted = axes.join(", ");
    let items: Vec<_> = object
        .try_iter()
        .map_err(|_| {
            PyTypeError::new_err(format!(
                "{name} is {object}, but must be a tuple, a list or an array ({wanted})"
            ))
        })?
        .collect::<PyResult<_>>()?;
    if items.len() == N {
        return Ok(items);
    }
    let found = items.len();
    Err(PyValueError::new_err(format!("{name} has {found} values, but must have {N} ({wanted})")))
}
