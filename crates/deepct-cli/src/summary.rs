//! What a verb prints about its result.

use crate::global::Global;

/// A result that can be printed as rows of text or as JSON.
pub(crate) trait Summary: serde::Serialize {
    /// Prints the rows.
    fn say(&self);

    /// Prints one line, for one of several files.
    fn say_line(&self) {
        self.say();
    }
}

/// The form in which a result is printed.
#[derive(Debug, Clone, Copy, clap::Args)]
pub(crate) struct Form {
    /// Print JSON in place of rows of text
    #[arg(long)]
    pub(crate) json: bool,
}

impl Form {
    /// Prints a result; rows only unless the user asked for errors only.
    pub(crate) fn print(self, summary: &impl Summary, global: &Global) {
        if self.json {
            print_json(summary);
        } else if !global.quiet {
            summary.say();
        }
    }

    /// Prints several results; as JSON, in one array.
    pub(crate) fn print_all(self, summaries: &[impl Summary], global: &Global) {
        if self.json {
            print_json(&summaries);
        } else {
            summaries.iter().for_each(|summary| self.print(summary, global));
        }
    }
}

/// Prints a value as JSON.
pub(crate) fn print_json(value: &impl serde::Serialize) {
    say!("{}", serde_json::to_string_pretty(value).expect("plain numbers and text"));
}
