//! Text for the user. Other than `println!`, these macros do not end the program if the output is
//! closed or full, so that a computation that is done is not lost.

use std::fmt::Arguments;
use std::io::{ErrorKind, Write};
use std::sync::atomic::{AtomicBool, Ordering};

/// Prints a line to the standard output.
macro_rules! say {
    ($($arguments:tt)*) => { crate::print::line(format_args!($($arguments)*)) };
}

/// Prints a line to the standard error output.
macro_rules! note {
    ($($arguments:tt)*) => { crate::print::note_line(format_args!($($arguments)*)) };
}

/// Whether text could not be written to the standard output, for another reason than that its
/// reader has closed it.
static FAILED: AtomicBool = AtomicBool::new(false);

/// See [`say!`].
pub(crate) fn line(arguments: Arguments) {
    write(format!("{arguments}\n").as_bytes());
}

/// Prints text that may have several lines, as it is.
pub(crate) fn raw(text: &str) {
    write(text.as_bytes());
}

fn write(text: &[u8]) {
    let text = printable(&String::from_utf8_lossy(text));
    let mut output = std::io::stdout().lock();
    match output.write_all(text.as_bytes()).and_then(|()| output.flush()) {
        Ok(()) => {}
        // The reader, such as `head`, has read enough.
        Err(problem) if problem.kind() == ErrorKind::BrokenPipe => {}
        Err(problem) => {
            if !FAILED.swap(true, Ordering::Relaxed) {
                note!("deepct: standard output: {problem}");
            }
        }
    }
}

/// See [`note!`].
pub(crate) fn note_line(arguments: Arguments) {
    // If this fails, there is no place to state it.
    let _ = writeln!(std::io::stderr().lock(), "{}", printable(&arguments.to_string()));
}

/// Whether all text could be printed.
pub(crate) fn succeeded() -> bool {
    !FAILED.load(Ordering::Relaxed)
}

/// The text with control characters escaped, which names and attributes in a file may contain and a
/// terminal would execute.
fn printable(text: &str) -> String {
    let escape = |character: char| match character {
        '\n' | '\t' => character.to_string(),
        other if other.is_control() => other.escape_default().to_string(),
        other => other.to_string(),
    };
    text.chars().map(escape).collect()
}

#[cfg(test)]
mod tests {
    #[test]
    fn control_characters_are_escaped() {
        assert_eq!(super::printable("µ\t1\n\u{1b}[2J\u{7}\r"), "µ\t1\n\\u{1b}[2J\\u{7}\\r");
    }
}
