//! An upper limit of the memory that a declared size may require.
//!
//! A file of a few bytes can declare arrays of any size. Sizes are therefore compared with a limit
//! before memory is allocated for them, since an allocation that fails ends the program.

use crate::error::{Error, Result};
use std::sync::atomic::{AtomicU64, Ordering};

/// Share of the memory of the machine that is the default limit.
const SHARE: f64 = 0.75;

/// The limit where the memory of the machine is unknown (bytes).
const UNKNOWN: u64 = 8_000_000_000;

/// The limit (bytes); 0 before it is first used.
static LIMIT: AtomicU64 = AtomicU64::new(0);

/// Sets the limit (bytes) of this process.
pub fn set_limit(bytes: u64) {
    LIMIT.store(bytes.max(1), Ordering::Relaxed);
}

/// The limit (bytes): by default three quarters of the memory of the machine.
pub fn limit() -> u64 {
    match LIMIT.load(Ordering::Relaxed) {
        0 => {
            let bytes = of_machine().map_or(UNKNOWN, |bytes| (SHARE * bytes as f64) as u64);
            set_limit(bytes);
            bytes
        }
        bytes => bytes,
    }
}

/// The memory that this process can use (bytes): that of the machine, or of its control group.
fn of_machine() -> Option<u64> {
    let text = |path: &str| std::fs::read_to_string(path).ok();
    let machine = text("/proc/meminfo")?
        .lines()
        .find_map(|line| line.strip_prefix("MemTotal:")?.trim().strip_suffix(" kB")?.parse().ok())
        .map(|kilobytes: u64| 1024 * kilobytes)?;
    let group = text("/sys/fs/cgroup/memory.max").and_then(|text| text.trim().parse().ok());
    Some(group.map_or(machine, |group: u64| machine.min(group)))
}

/// Returns an error if `count` values of `each` bytes are more than the limit. `what` names the
/// memory, for example "memory for the images".
///
/// # Errors
/// An [`Error::OutOfRange`] with the size and the limit.
pub(crate) fn check(what: &'static str, count: f64, each: f64) -> Result<()> {
    let (bytes, limit) = (count * each, limit());
    if bytes <= limit as f64 {
        return Ok(());
    }
    let range = format!(
        "at most {}, the limit of this process (`--max-memory`, by default three quarters of \
         the memory of the machine)",
        size(limit as f64)
    );
    Err(Error::out_of_range(what, size(bytes), range))
}

/// A number of bytes in words.
fn size(bytes: f64) -> String {
    match bytes / 1e9 {
        large if large >= 1e5 => format!("{large:.1e} GB"),
        size => format!("{size:.1} GB"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 1 PB is above the limit of any machine, and the message states both numbers.
    #[test]
    fn sizes_above_the_limit_are_refused() {
        check("memory for a test", 1e3, 8.0).unwrap();
        let message = check("memory for a test", 1e15, 1.0).unwrap_err().to_string();
        assert!(message.starts_with("memory for a test is 1.0e6 GB, but must be"), "{message}");
        assert!(message.contains("--max-memory"), "{message}");
        assert!(limit() > 100_000_000);
    }
}
