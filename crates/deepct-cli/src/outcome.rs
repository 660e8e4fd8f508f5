//! How a verb that did not fail ended.

/// How a verb that did not fail ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// Done.
    Success,
    /// A check that was asked for did not hold.
    CheckFailed,
}
