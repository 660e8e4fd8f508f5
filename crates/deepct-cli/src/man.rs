//! `deepct man`: manual pages.

use crate::{Outcome, command};
use clap::Command;
use clap_mangen::Man;
use deepct_core::{Error, Result, files};
use std::path::PathBuf;

/// Print a manual page, or write all of them to a folder
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The verb of the page, such as `cloud import`; by default, the page of the program
    verb: Vec<String>,
    /// Folder to write the manual pages of all verbs to
    #[arg(long, value_name = "DIR", conflicts_with = "verb")]
    out: Option<PathBuf>,
}

/// The sections that clap does not know.
const LAST_SECTIONS: &str = "\
.SH \"EXIT STATUS\"
0 on success, 1 if a requested check failed, 2 on an error, 130 if the user interrupted the command.
";

pub(crate) fn run(args: &Args) -> Result<Outcome> {
    let mut program = command().disable_help_subcommand(true);
    program.build();
    if let Some(folder) = &args.out {
        std::fs::create_dir_all(folder).map_err(Error::io(folder))?;
        for page in pages(&program) {
            files::write(&folder.join(format!("{}.1", name(page))), roff(page, &program))?;
        }
        return Ok(Outcome::Success);
    }
    let mut page = &program;
    for verb in &args.verb {
        page = page.find_subcommand(verb).ok_or_else(|| {
            let known: Vec<_> = page.get_subcommands().map(Command::get_name).collect();
            let range = match known.as_slice() {
                [] => {
                    format!("nothing: `{}` has no verbs", page.get_bin_name().unwrap_or_default())
                }
                _ => format!("one of {}", known.join(", ")),
            };
            Error::out_of_range("verb", format!("\"{verb}\""), range)
        })?;
    }
    crate::print::raw(&roff(page, &program));
    Ok(Outcome::Success)
}

/// A command and those below it.
fn pages(command: &Command) -> Vec<&Command> {
    let below = command.get_subcommands().flat_map(pages);
    std::iter::once(command).chain(below).collect()
}

/// The name of a page: `deepct-cloud-import`.
fn name(page: &Command) -> String {
    page.get_bin_name().unwrap_or_else(|| page.get_name()).replace(' ', "-")
}

/// A page in the language of `man`.
fn roff(page: &Command, program: &Command) -> String {
    let man = Man::new(page.clone().display_name(name(page)));
    let mut text = Vec::new();
    let sections = [
        Man::render_title,
        Man::render_name_section,
        Man::render_synopsis_section,
        Man::render_description_section,
        Man::render_options_section,
    ];
    for render in sections {
        render(&man, &mut text).expect("memory can be written");
    }
    if page.has_subcommands() {
        man.render_subcommands_section(&mut text).expect("memory can be written");
    }
    let mut text = String::from_utf8(text).expect("text");
    if let Some(notes) = page.get_after_long_help() {
        // Without filling, which would join the lines.
        text += &format!(".SH NOTES\n.nf\n{}\n.fi\n", escaped(&notes.to_string()));
    }
    let parent = |name: &str| name.rsplit_once('-').map(|(parent, _)| parent.to_owned());
    let this = name(page);
    let related = pages(program).into_iter().map(name);
    let related = related.filter(|other| {
        parent(other).as_ref() == Some(&this) || parent(&this).as_ref() == Some(other)
    });
    let related: Vec<_> = related.map(|other| format!("\\fB{}\\fR(1)", escaped(&other))).collect();
    text + LAST_SECTIONS + &format!(".SH \"SEE ALSO\"\n{}\n", related.join(", "))
}

/// Text in which nothing is a command of roff.
fn escaped(text: &str) -> String {
    let lines = text.lines().map(|line| {
        let line = line.replace('\\', "\\e").replace('-', "\\-");
        if line.starts_with(['.', '\'']) { format!("\\&{line}") } else { line }
    });
    lines.collect::<Vec<_>>().join("\n")
}
