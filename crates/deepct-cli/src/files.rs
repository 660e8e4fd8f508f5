//! Verbs that process several files with the same settings.

use crate::global::Global;
use crate::output::{check_origin, is_same_file};
use crate::summary::{Form, Summary, print_json};
use deepct_core::files::check_output;
use deepct_core::io::{Lineage, read_lineage};
use deepct_core::{Error, Result};
use std::path::{Path, PathBuf};

/// The files of a verb, and where its outputs are written.
#[derive(Debug, clap::Args)]
pub(crate) struct Files {
    /// Files of images
    #[arg(required = true, value_name = "IMAGES")]
    images: Vec<PathBuf>,
    /// File to write, for the images of a single scene
    #[arg(long, value_name = "FILE.nc", required_unless_present = "out_dir")]
    out: Option<PathBuf>,
    /// Folder to write to: one file for each file of images, with the same name. A file that cannot
    /// be processed is reported, and the others are processed all the same
    #[arg(long, value_name = "DIR", conflicts_with = "out")]
    out_dir: Option<PathBuf>,
    #[command(flatten)]
    form: Form,
}

/// The lineage of an output of a verb: that of its input, and the verb.
pub(crate) fn lineage(verb: &str, input: &Path) -> Lineage {
    let name = input.file_name().unwrap_or_default().to_string_lossy();
    read_lineage(input).then(&format!("{verb} {name}"))
}

impl Files {
    /// Calls `process` with each file of images and the file to write, and prints what it returns.
    ///
    /// # Errors
    /// As [`Files::each_scene`]; several files with --out.
    pub(crate) fn each<S: Summary>(
        &self,
        global: &Global,
        process: impl Fn(&Path, &Path) -> Result<S>,
    ) -> Result<()> {
        if self.out.is_some() && self.images.len() > 1 {
            let range = "1 with --out; give --out-dir for several files";
            return Err(Error::out_of_range("number of files", self.images.len(), range));
        }
        self.each_scene(global, |images, out| process(&images[0], out))
    }

    /// Calls `process` with the files of images of each scene and the file to write, and prints what it
    /// returns. With --out, all files are of one scene; with --out-dir, each is of a scene of its own.
    ///
    /// # Errors
    /// Outputs that cannot be written or would replace an input, before anything is processed; the
    /// error of a single scene; and, after all scenes, the number of those that could not be processed,
    /// whose errors have been printed.
    pub(crate) fn each_scene<S: Summary>(
        &self,
        global: &Global,
        process: impl Fn(&[PathBuf], &Path) -> Result<S>,
    ) -> Result<()> {
        let mut summaries = Vec::new();
        let result = self.process(global.force, |images, out| {
            let summary = process(images, out)?;
            match self.out_dir {
                _ if self.form.json || global.quiet => {}
                None => summary.say(),
                Some(_) => summary.say_line(),
            }
            summaries.push(summary);
            Ok(())
        });
        if self.form.json {
            print_json(&summaries);
        }
        result
    }

    fn process(
        &self,
        force: bool,
        mut process: impl FnMut(&[PathBuf], &Path) -> Result<()>,
    ) -> Result<()> {
        let outputs = self.outputs(force)?;
        if self.out_dir.is_none() {
            return process(&self.images, &outputs[0]);
        }
        let mut failed = 0;
        for (images, out) in self.images.chunks(1).zip(&outputs) {
            match process(images, out) {
                Ok(()) => {}
                Err(Error::Interrupted) => return Err(Error::Interrupted),
                Err(problem) => {
                    note!("deepct: {problem}");
                    failed += 1;
                }
            }
        }
        if failed == 0 {
            return Ok(());
        }
        let range = "0: see the messages above";
        Err(Error::out_of_range("number of files that failed", failed, range))
    }

    /// The files to write.
    fn outputs(&self, force: bool) -> Result<Vec<PathBuf>> {
        let outputs: Vec<PathBuf> = match (&self.out, &self.out_dir) {
            (Some(out), _) => vec![out.clone()],
            (None, folder) => {
                let folder = folder.as_deref().unwrap_or(Path::new("."));
                self.images
                    .iter()
                    .map(|images| folder.join(images.file_name().unwrap_or_default()))
                    .collect()
            }
        };
        let lost = |out: &Path, problem: &str| {
            Error::file(out, "--out-dir", problem, "give another folder, or rename the files")
        };
        for (number, out) in outputs.iter().enumerate() {
            if outputs[..number].contains(out) {
                return Err(lost(out, "is the output of two files, of which one would be lost"));
            }
            if self.out_dir.is_some() && self.images.iter().any(|images| is_same_file(images, out))
            {
                return Err(lost(out, "is an input of this command, which would be lost"));
            }
        }
        self.out_dir
            .iter()
            .try_for_each(|folder| std::fs::create_dir_all(folder).map_err(Error::io(folder)))?;
        outputs.iter().try_for_each(|out| {
            check_output(out)?;
            check_origin(out, "--out-dir", force)
        })?;
        Ok(outputs)
    }
}
