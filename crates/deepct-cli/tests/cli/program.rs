//! A temporary folder for one test, in which the program is run.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A temporary folder in which the program runs.
pub(crate) struct Program {
    folder: tempfile::TempDir,
}

/// Exit status and output of a run of the program.
pub(crate) struct Run {
    pub(crate) code: i32,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

impl Program {
    pub(crate) fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    /// The path of a file in the folder.
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The names of the files in the folder.
    pub(crate) fn files(&self) -> Vec<String> {
        let mut names: Vec<_> = std::fs::read_dir(self.folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    /// The program with the arguments of a command line, separated by whitespace.
    pub(crate) fn command(&self, arguments: &str) -> Command {
        let mut command = Command::new(Path::new(env!("CARGO_BIN_EXE_deepct")));
        command
            .args(arguments.split_whitespace())
            .current_dir(self.folder.path())
            // HDF5 locks the files that it writes. A program started by one test inherits the
            // lock of a file that another test is writing, and would not release it.
            .env("HDF5_USE_FILE_LOCKING", "FALSE");
        command
    }

    /// Runs the program with the arguments of a command line, separated by whitespace.
    pub(crate) fn run(&self, arguments: &str) -> Run {
        let output: Output = self.command(arguments).output().unwrap();
        Run {
            code: output.status.code().unwrap(),
            stdout: String::from_utf8(output.stdout).unwrap(),
            stderr: String::from_utf8(output.stderr).unwrap(),
        }
    }

    /// Runs a command line that must succeed. Returns the standard output.
    pub(crate) fn succeed(&self, arguments: &str) -> String {
        let run = self.run(arguments);
        assert_eq!(run.code, 0, "deepct {arguments}: {}", run.stderr);
        run.stdout
    }

    /// Runs a command line that must fail: with exit status 2, an error of one line that contains
    /// all `words`, and no file created or removed.
    pub(crate) fn refuse(&self, arguments: &str, words: &[&str]) {
        let before = self.files();
        let run = self.run(arguments);
        assert_eq!(run.code, 2, "deepct {arguments}: {}{}", run.stdout, run.stderr);
        assert_eq!(run.stderr.trim_end().lines().count(), 1, "{}", run.stderr);
        for word in words {
            assert!(run.stderr.contains(word), "no \"{word}\" in: {}", run.stderr);
        }
        assert_eq!(self.files(), before, "deepct {arguments} left a file behind");
    }
}
