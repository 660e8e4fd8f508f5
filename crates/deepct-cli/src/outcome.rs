//! Outcome of a verb that ended without an error.

/// Outcome of a verb that ended without an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// The verb completed.
    Success,
    /// A requested check failed.
    CheckFailed,
    /// The user interrupted it: the files hold what was computed until then.
    Interrupted,
}
