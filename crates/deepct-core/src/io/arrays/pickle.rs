//! Pickles of Python (`.pkl`, protocols 2 to 5) that consist of NumPy arrays, numbers, texts, lists,
//! tuples, sets and dictionaries.
//!
//! A pickle is a program that builds objects, and Python executes any function that it names. This
//! reader knows the few names by which NumPy writes its arrays and executes nothing; a pickle with
//! another name is refused. Source: the module `pickletools` of Python, which documents the operations.

use super::{Array, Arrays, DEEPEST, Number, Stored, numpy_type};
use crate::error::{Error, Result};
use crate::{files, memory};
use std::cell::Cell;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

/// Largest number of operations of a pickle, and the memory that one may take (bytes).
const MOST_OPERATIONS: u64 = 1 << 22;
const OPERATION_BYTES: u64 = 256;

/// What a pickle may name.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Name {
    /// The function that makes an empty array.
    EmptyArray,
    /// The class of arrays.
    ArrayClass,
    /// The class of types of numbers.
    Type,
    /// The function that makes an array of a buffer.
    OfBuffer,
    /// The function that makes a number of NumPy.
    Scalar,
    /// The function that turns text into bytes.
    Encode,
    /// A builtin class of bytes.
    Bytes,
    /// A dictionary.
    Dictionary,
    /// A set, or a complex number, of which nothing is read.
    Unread,
}

/// An object, with the numbers of those that it contains.
#[derive(Debug, Clone)]
enum Object {
    Nothing,
    Number(f64),
    /// A part of the file that is text, or bytes.
    Text(Range<usize>),
    Bytes(Range<usize>),
    /// The bytes that are the letters of a text.
    Letters(Range<usize>),
    List(Vec<usize>),
    Dictionary(Vec<(usize, usize)>),
    Named(Name),
    Type(Stored),
    /// An array before its state is known.
    EmptyArray,
    Array {
        shape: Vec<usize>,
        stored: Stored,
        is_first_fastest: bool,
        data: usize,
    },
}

/// Why a pickle is refused: the problem and, unless the file is damaged, the remedy.
type Refusal = (String, Option<&'static str>);
type Outcome<T> = std::result::Result<T, Refusal>;

const AS_ARRAYS: &str = "write its arrays with numpy.savez, or as a dictionary of NumPy arrays";

/// The state of the program.
struct Machine<'a> {
    bytes: &'a [u8],
    next: usize,
    objects: Vec<Object>,
    stack: Vec<usize>,
    /// The lengths of the stack at the marks.
    marks: Vec<usize>,
    memo: HashMap<u64, usize>,
}

/// List the arrays of a file.
pub(super) fn list(arrays: &mut Arrays) -> Result<()> {
    let path = arrays.path.clone();
    let size = std::fs::metadata(&path).map_err(Error::io(&path))?.len();
    memory::check("memory for the pickle", size as f64, 2.0).map_err(Error::in_file(&path))?;
    let bytes: Arc<[u8]> = files::read(&path, memory::limit())?.into();
    let mut machine = Machine {
        bytes: &bytes,
        next: 0,
        objects: Vec::new(),
        stack: Vec::new(),
        marks: Vec::new(),
        memo: HashMap::new(),
    };
    let refuse = |(problem, remedy): Refusal| match remedy {
        Some(remedy) => Error::file(&path, "file", problem, remedy),
        None => {
            let problem = format!("is truncated or damaged: {problem}");
            Error::file(&path, "file", problem, "copy it again from its source")
        }
    };
    let whole = machine.run().map_err(refuse)?;
    let objects =
        Objects { objects: &machine.objects, bytes: &bytes, left: MOST_OPERATIONS.into() };
    objects.list(whole, None, DEEPEST, arrays)
}

/// The objects of a pickle.
struct Objects<'a> {
    objects: &'a [Object],
    bytes: &'a Arc<[u8]>,
    /// How many objects may still be listed: one that is contained in several is listed for each.
    left: Cell<u64>,
}

impl Objects<'_> {
    /// Adds the arrays in an object, which has a name unless it is the whole pickle.
    fn list(
        &self,
        object: usize,
        name: Option<&str>,
        depth: usize,
        arrays: &mut Arrays,
    ) -> Result<()> {
        let own_name = name.map_or_else(|| arrays.stem(), str::to_owned);
        let inside = |part: String| name.map_or(part.clone(), |name| format!("{name}/{part}"));
        if depth == 0 {
            let problem = format!("contains more than {DEEPEST} structures inside each other");
            return Err(arrays.error("file", problem, AS_ARRAYS));
        }
        let parts = match &self.objects[object] {
            Object::List(parts) => parts.len(),
            Object::Dictionary(entries) => entries.len(),
            _ => 0,
        };
        self.left.set(self.left.get().saturating_sub(1 + parts as u64));
        if self.left.get() == 0 {
            let problem = format!("contains more than {MOST_OPERATIONS} objects");
            return Err(arrays.error("file", problem, AS_ARRAYS));
        }
        match &self.objects[object] {
            Object::Array { shape, stored, is_first_fastest, data } => {
                let array = Array::new(shape.clone(), stored.clone(), self.source(*data));
                arrays.insert(&own_name, Array { is_first_fastest: *is_first_fastest, ..array })
            }
            Object::Number(value) => arrays.insert(&own_name, Array::of_values(vec![1], &[*value])),
            Object::List(parts) => match self.numbers(parts) {
                Some(values) => {
                    arrays.insert(&own_name, Array::of_values(vec![values.len()], &values))
                }
                None => {
                    for (number, part) in parts.iter().enumerate() {
                        self.list(*part, Some(&inside(number.to_string())), depth - 1, arrays)?;
                    }
                    Ok(())
                }
            },
            Object::Dictionary(entries) => {
                for (key, value) in entries {
                    let key = match &self.objects[*key] {
                        Object::Text(range) | Object::Bytes(range) => {
                            String::from_utf8_lossy(&self.bytes[range.clone()]).into_owned()
                        }
                        Object::Number(number) => number.to_string(),
                        _ => continue,
                    };
                    self.list(*value, Some(&inside(key)), depth - 1, arrays)?;
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// The values of a list of numbers.
    fn numbers(&self, parts: &[usize]) -> Option<Vec<f64>> {
        let value = |part: &usize| match self.objects[*part] {
            Object::Number(value) => Some(value),
            _ => None,
        };
        let values: Option<Vec<_>> = parts.iter().map(value).collect();
        values.filter(|values| !values.is_empty())
    }

    fn source(&self, data: usize) -> super::Source {
        let bytes = self.bytes.clone();
        match self.objects[data].clone() {
            Object::Bytes(range) => Box::new(move |read| read(&mut &bytes[range.clone()])),
            Object::Letters(range) => Box::new(move |read| {
                let text = String::from_utf8_lossy(&bytes[range.clone()]);
                let letters: Vec<_> = text.chars().map(|letter| letter as u8).collect();
                read(&mut &letters[..])
            }),
            _ => Box::new(|_| Err(std::io::Error::other("is not read"))),
        }
    }
}

fn damaged<T>(problem: impl Into<String>) -> Outcome<T> {
    Err((problem.into(), None))
}

impl Machine<'_> {
    /// Runs the program; returns the object that it builds.
    fn run(&mut self) -> Outcome<usize> {
        let most = MOST_OPERATIONS.min(memory::limit() / OPERATION_BYTES);
        for _ in 0..most {
            if self.step()? {
                return self.pop();
            }
        }
        Err((format!("consists of more than {most} objects"), Some(AS_ARRAYS)))
    }

    /// Executes an operation; returns whether it is the last one.
    fn step(&mut self) -> Outcome<bool> {
        let operation = self.byte()?;
        match operation {
            b'.' => return Ok(true),
            // The protocol, a frame.
            0x80 => self.skip(1)?,
            0x95 => self.skip(8)?,
            b'(' => self.marks.push(self.stack.len()),
            b'0' => {
                self.pop()?;
            }
            b'1' => {
                self.since_mark()?;
            }
            b'2' => {
                let top = self.pop()?;
                self.stack.extend([top, top]);
            }
            b'N' => self.push(Object::Nothing),
            0x88 => self.push(Object::Number(1.0)),
            0x89 => self.push(Object::Number(0.0)),
            b'J' => {
                let value = self.unsigned(4)? as u32 as i32;
                self.push(Object::Number(value.into()));
            }
            b'K' => self.whole(1)?,
            b'M' => self.whole(2)?,
            0x8a | 0x8b => {
                let length = self.length(if operation == 0x8a { 1 } else { 4 })?;
                let bytes = &self.bytes[self.take(length)?];
                self.push(long(bytes));
            }
            b'G' => {
                let value = f64::from_bits(self.unsigned(8)?.swap_bytes());
                self.push(Object::Number(value));
            }
            // Texts of Python 2, which may be bytes.
            b'U' | b'C' => self.bytes_of(1)?,
            b'T' | b'B' => self.bytes_of(4)?,
            0x8e | 0x96 => self.bytes_of(8)?,
            0x8c => self.text_of(1)?,
            b'X' => self.text_of(4)?,
            0x8d => self.text_of(8)?,
            b']' | b')' | 0x8f => self.push(Object::List(Vec::new())),
            b'}' => self.push(Object::Dictionary(Vec::new())),
            b't' | 0x91 => {
                let parts = self.since_mark()?;
                self.push(Object::List(parts));
            }
            0x85..=0x87 => {
                let count = usize::from(operation - 0x84);
                let parts = self.stack.split_off(self.stack.len().saturating_sub(count));
                self.push(Object::List(parts));
            }
            b'a' => {
                let part = self.pop()?;
                self.extend(vec![part])?;
            }
            b'e' | 0x90 => {
                let parts = self.since_mark()?;
                self.extend(parts)?;
            }
            b's' => {
                let (value, key) = (self.pop()?, self.pop()?);
                self.extend(vec![key, value])?;
            }
            b'u' => {
                let parts = self.since_mark()?;
                self.extend(parts)?;
            }
            b'q' => self.put(1)?,
            b'r' => self.put(4)?,
            0x94 => {
                let top = self.top()?;
                self.memo.insert(self.memo.len() as u64, top);
            }
            b'h' => self.get(1)?,
            b'j' => self.get(4)?,
            b'c' => {
                let [module, name] = [self.line()?, self.line()?];
                self.named(&module, &name)?;
            }
            0x93 => {
                let [name, module] = [self.pop_text()?, self.pop_text()?];
                self.named(&module, &name)?;
            }
            b'R' => {
                let (arguments, function) = (self.pop()?, self.pop()?);
                let made = self.call(function, arguments)?;
                self.push(made);
            }
            b'b' => {
                let state = self.pop()?;
                self.set_state(state)?;
            }
            0x97 | 0x98 => {
                return Err(("has its buffers in another place".into(), Some(AS_ARRAYS)));
            }
            b'P' | b'Q' => {
                let problem = "refers to objects outside of it, as those of PyTorch do";
                return Err((problem.into(), Some(AS_ARRAYS)));
            }
            b'i' | b'o' | 0x81 | 0x92 | 0x82..=0x84 => {
                let problem = "contains objects of classes; only NumPy arrays, numbers, texts, lists and \
                               dictionaries are read";
                return Err((problem.into(), Some(AS_ARRAYS)));
            }
            _ => return damaged(format!("there is no operation {operation:#04x}")),
        }
        Ok(false)
    }

    fn skip(&mut self, count: usize) -> Outcome<()> {
        self.take(count).map(|_| ())
    }

    /// The next bytes as a part of the file.
    fn take(&mut self, count: usize) -> Outcome<Range<usize>> {
        let start = self.next;
        match start.checked_add(count).filter(|end| *end <= self.bytes.len()) {
            Some(end) => {
                self.next = end;
                Ok(start..end)
            }
            None => damaged(format!("it declares {count} bytes, but ends before")),
        }
    }

    fn byte(&mut self) -> Outcome<u8> {
        let range = self.take(1)?;
        Ok(self.bytes[range.start])
    }

    /// A little-endian number of so many bytes.
    fn unsigned(&mut self, size: usize) -> Outcome<u64> {
        let range = self.take(size)?;
        let mut bytes = [0; 8];
        bytes[..size].copy_from_slice(&self.bytes[range]);
        Ok(u64::from_le_bytes(bytes))
    }

    fn length(&mut self, size: usize) -> Outcome<usize> {
        let length = self.unsigned(size)?;
        usize::try_from(length).or_else(|_| damaged(format!("it declares {length} bytes")))
    }

    fn whole(&mut self, size: usize) -> Outcome<()> {
        let value = self.unsigned(size)?;
        self.push(Object::Number(value as f64));
        Ok(())
    }

    fn bytes_of(&mut self, size: usize) -> Outcome<()> {
        let length = self.length(size)?;
        let range = self.take(length)?;
        self.push(Object::Bytes(range));
        Ok(())
    }

    fn text_of(&mut self, size: usize) -> Outcome<()> {
        let length = self.length(size)?;
        let range = self.take(length)?;
        self.push(Object::Text(range));
        Ok(())
    }

    /// The rest of a line.
    fn line(&mut self) -> Outcome<String> {
        let rest = &self.bytes[self.next..];
        let Some(length) = rest.iter().position(|byte| *byte == b'\n') else {
            return damaged("it ends in a name");
        };
        self.next += length + 1;
        Ok(String::from_utf8_lossy(&rest[..length]).into_owned())
    }

    fn push(&mut self, object: Object) {
        self.stack.push(self.objects.len());
        self.objects.push(object);
    }

    fn top(&self) -> Outcome<usize> {
        self.stack.last().copied().map_or_else(|| damaged("it uses an object that it lacks"), Ok)
    }

    fn pop(&mut self) -> Outcome<usize> {
        let top = self.top()?;
        self.stack.pop();
        Ok(top)
    }

    fn text(&self, object: usize) -> Outcome<String> {
        match &self.objects[object] {
            Object::Text(range) | Object::Bytes(range) => {
                Ok(String::from_utf8_lossy(&self.bytes[range.clone()]).into_owned())
            }
            _ => damaged("a name is no text"),
        }
    }

    fn pop_text(&mut self) -> Outcome<String> {
        let object = self.pop()?;
        self.text(object)
    }

    fn since_mark(&mut self) -> Outcome<Vec<usize>> {
        match self.marks.pop().filter(|mark| *mark <= self.stack.len()) {
            Some(mark) => Ok(self.stack.split_off(mark)),
            None => damaged("a mark is missing"),
        }
    }

    /// Adds parts to the list or, in pairs of a key and a value, to the dictionary on the stack.
    fn extend(&mut self, parts: Vec<usize>) -> Outcome<()> {
        let top = self.top()?;
        match &mut self.objects[top] {
            Object::List(list) => list.extend(parts),
            Object::Dictionary(entries) => {
                entries.extend(parts.as_chunks::<2>().0.iter().map(|[key, value]| (*key, *value)));
            }
            Object::Nothing => {}
            _ => return damaged("it adds to an object that is no list"),
        }
        Ok(())
    }

    fn put(&mut self, size: usize) -> Outcome<()> {
        let (place, top) = (self.unsigned(size)?, self.top()?);
        self.memo.insert(place, top);
        Ok(())
    }

    fn get(&mut self, size: usize) -> Outcome<()> {
        let place = self.unsigned(size)?;
        match self.memo.get(&place) {
            Some(object) => {
                self.stack.push(*object);
                Ok(())
            }
            None => damaged("it uses an object that it lacks"),
        }
    }

    /// Pushes what a name stands for.
    fn named(&mut self, module: &str, name: &str) -> Outcome<()> {
        let of_numpy =
            module.strip_prefix("numpy.core.").or_else(|| module.strip_prefix("numpy._core."));
        let builtin = ["builtins", "__builtin__"].contains(&module);
        let found = match (of_numpy, name) {
            (Some("multiarray"), "_reconstruct") => Name::EmptyArray,
            (Some("multiarray"), "scalar") => Name::Scalar,
            (Some("numeric"), "_frombuffer") => Name::OfBuffer,
            (None, "ndarray") if module == "numpy" => Name::ArrayClass,
            (None, "dtype") if module == "numpy" => Name::Type,
            (None, "encode") if module == "_codecs" => Name::Encode,
            (None, "OrderedDict") if module == "collections" => Name::Dictionary,
            (None, "bytes" | "bytearray") if builtin => Name::Bytes,
            (None, "set" | "frozenset" | "complex") if builtin => Name::Unread,
            _ => {
                let printable = |text: &str| -> String {
                    text.chars().filter(|letter| !letter.is_control()).take(80).collect()
                };
                let problem = format!(
                    "names {}.{}, which is not executed; only NumPy arrays, numbers, texts, lists and \
                     dictionaries are read",
                    printable(module),
                    printable(name)
                );
                return Err((problem, Some(AS_ARRAYS)));
            }
        };
        self.push(Object::Named(found));
        Ok(())
    }

    /// What a function that is known makes of its arguments.
    fn call(&self, function: usize, arguments: usize) -> Outcome<Object> {
        let Object::Named(name) = self.objects[function] else {
            return damaged("it calls what is no function");
        };
        let Object::List(arguments) = &self.objects[arguments] else {
            return damaged("the arguments of a function are no tuple");
        };
        match (name, &arguments[..]) {
            (Name::EmptyArray, [class, ..]) => match self.objects[*class] {
                Object::Named(Name::ArrayClass) => Ok(Object::EmptyArray),
                _ => damaged("an array is of no known class"),
            },
            (Name::Type, [text, ..]) => Ok(Object::Type(numpy_type(&self.text(*text)?))),
            (Name::OfBuffer, [data, stored, shape, order]) => {
                self.array(*shape, *stored, self.text(*order)? == "F", *data)
            }
            (Name::Scalar, [stored, data]) => match (&self.objects[*stored], self.part(*data)) {
                (Object::Type(stored), Some(bytes)) => Ok(scalar(stored, &bytes)),
                _ => Ok(Object::Nothing),
            },
            (Name::Encode, [text, ..]) => match &self.objects[*text] {
                Object::Text(range) => Ok(Object::Letters(range.clone())),
                _ => damaged("it encodes what is no text"),
            },
            (Name::Bytes, []) => Ok(Object::Bytes(0..0)),
            (Name::Bytes, [bytes, ..]) => match self.objects[*bytes].clone() {
                Object::Text(range) => Ok(Object::Letters(range)),
                bytes @ (Object::Bytes(_) | Object::Letters(_)) => Ok(bytes),
                _ => Ok(Object::Nothing),
            },
            (Name::Dictionary, _) => Ok(Object::Dictionary(Vec::new())),
            (Name::Unread, _) => Ok(Object::Nothing),
            _ => damaged("a function has wrong arguments"),
        }
    }

    /// The bytes of a short object.
    fn part(&self, object: usize) -> Option<Vec<u8>> {
        match &self.objects[object] {
            Object::Bytes(range) if range.len() <= 16 => Some(self.bytes[range.clone()].to_vec()),
            Object::Letters(range) if range.len() <= 32 => {
                let text = String::from_utf8_lossy(&self.bytes[range.clone()]);
                Some(text.chars().map(|letter| letter as u8).collect())
            }
            _ => None,
        }
    }

    /// Gives the object on the stack its state.
    fn set_state(&mut self, state: usize) -> Outcome<()> {
        let top = self.top()?;
        let parts = match &self.objects[state] {
            Object::List(parts) => parts.clone(),
            _ => Vec::new(),
        };
        let object = match (&self.objects[top], &parts[..]) {
            (Object::Type(stored), [_, order, ..]) => {
                let big_endian = self.text(*order)? == ">";
                Object::Type(Stored { big_endian, ..stored.clone() })
            }
            (Object::EmptyArray, [_, shape, stored, order, data]) => {
                let is_first_fastest =
                    matches!(self.objects[*order], Object::Number(order) if order != 0.0);
                self.array(*shape, *stored, is_first_fastest, *data)?
            }
            _ => return damaged("it gives an object a state that it cannot have"),
        };
        self.objects[top] = object;
        Ok(())
    }

    /// An array; nothing if it is of objects.
    fn array(
        &self,
        shape: usize,
        stored: usize,
        is_first_fastest: bool,
        data: usize,
    ) -> Outcome<Object> {
        let (Object::List(lengths), Object::Type(stored)) =
            (&self.objects[shape], &self.objects[stored])
        else {
            return damaged("an array has no shape or no type");
        };
        let length = |part: &usize| match self.objects[*part] {
            Object::Number(length) if (0.0..9e15).contains(&length) => Ok(length as usize),
            _ => damaged("an array has no shape"),
        };
        let shape: Vec<_> = lengths.iter().map(length).collect::<Outcome<_>>()?;
        let bytes = match &self.objects[data] {
            // A letter has one or two bytes.
            Object::Bytes(range) | Object::Letters(range) => range.len() as u64,
            _ => return Ok(Object::Nothing),
        };
        let is_number = !matches!(stored.number, Number::Other(_));
        if is_number && stored.size_of(&shape).is_none_or(|size| size > bytes) {
            return damaged(format!(
                "an array declares the shape {shape:?}, but has {bytes} bytes"
            ));
        }
        Ok(Object::Array { shape, stored: stored.clone(), is_first_fastest, data })
    }
}

/// A number of NumPy.
fn scalar(stored: &Stored, bytes: &[u8]) -> Object {
    match stored.number {
        Number::Other(_) => Object::Nothing,
        _ if bytes.len() == stored.size() => Object::Number(stored.value(bytes)),
        _ => Object::Nothing,
    }
}

/// A whole number in two's complement; nothing if it is large.
fn long(bytes: &[u8]) -> Object {
    if bytes.len() > 8 {
        return Object::Nothing;
    }
    let negative = bytes.last().is_some_and(|byte| byte & 0x80 != 0);
    let mut all = [if negative { 0xff } else { 0 }; 8];
    all[..bytes.len()].copy_from_slice(bytes);
    Object::Number(i64::from_le_bytes(all) as f64)
}
