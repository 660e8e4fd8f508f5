//! `deepct view` and `deepct report`: pages to look at.

use crate::global::Global;
use crate::outcome::Outcome;
use crate::output::check_origin;
use deepct_core::report::{Report, file_report, folder_report};
use deepct_core::{Error, Result};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Write an HTML page with an interactive 3D view of a volume, a cloud or a mask, or with images
///
/// The page contains all it shows and needs no network. The view turns by dragging; truth and
/// estimate have the same camera, colours and slices.
#[derive(Debug, clap::Args)]
pub(crate) struct ViewArgs {
    /// File of a volume, a cloud, a mask or images
    file: PathBuf,
    /// File of the true cloud, shown beside the volume, with scores and the difference
    #[arg(long, value_name = "C.nc")]
    truth: Option<PathBuf>,
    #[command(flatten)]
    page: Page,
}

/// Write an HTML page of a folder: scores, volumes in 3D, images and pictures
///
/// The folder may be that of `deepct demo` or `deepct experiment`, or one with the files of the
/// processing chain. The truth is the only cloud with droplets in the folder, or else the file
/// truth.nc or cloud.nc.
#[derive(Debug, clap::Args)]
pub(crate) struct ReportArgs {
    /// Folder with the files
    folder: PathBuf,
    /// File of the true cloud, if it is not in the folder or not found there
    #[arg(long, value_name = "C.nc")]
    truth: Option<PathBuf>,
    #[command(flatten)]
    page: Page,
}

/// What is done with the page.
#[derive(Debug, clap::Args)]
struct Page {
    /// HTML file to write; by default beside the input
    #[arg(long, value_name = "FILE.html")]
    out: Option<PathBuf>,
    /// Open the page in the browser
    #[arg(long)]
    open: bool,
}

pub(crate) fn view(args: &ViewArgs, global: &Global) -> Result<Outcome> {
    let by_default = args.file.with_extension("html");
    args.page.write(by_default, global, || file_report(&args.file, args.truth.as_deref()))
}

pub(crate) fn report(args: &ReportArgs, global: &Global) -> Result<Outcome> {
    let by_default = args.folder.join("report.html");
    args.page.write(by_default, global, || folder_report(&args.folder, args.truth.as_deref()))
}

impl Page {
    fn write(
        &self,
        by_default: PathBuf,
        global: &Global,
        make: impl FnOnce() -> Result<Report>,
    ) -> Result<Outcome> {
        let out = self.out.as_ref().unwrap_or(&by_default);
        if out.extension().is_none_or(|found| !found.eq_ignore_ascii_case("html")) {
            let range = "the name of an HTML file, ending in .html";
            return Err(Error::out_of_range("--out", out.display(), range));
        }
        check_origin(out, "--out", global.force)?;
        let report = make()?;
        report.write(out)?;
        say!("{}", out.display());
        if self.open {
            open(out)?;
        }
        Ok(Outcome::Success)
    }
}

/// Opens a page in the browser of the desktop.
fn open(page: &Path) -> Result<()> {
    let program = match std::env::consts::OS {
        "macos" => "open",
        "windows" => "explorer",
        _ => "xdg-open",
    };
    let page = page.canonicalize().map_err(Error::io(page))?;
    let mut command = Command::new(program);
    command.arg(&page).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    match command.spawn() {
        Ok(_) => Ok(()),
        Err(problem) => {
            let problem = format!("cannot be opened by {program}: {problem}");
            Err(Error::file(page, "--open", problem, "open the file in a browser"))
        }
    }
}
