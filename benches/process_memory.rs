//! Memory use of the process, as reported by Linux.

/// Reset the peak memory use of the process. Returns whether the system supports this.
pub(crate) fn restart_peak() -> bool {
    std::fs::write("/proc/self/clear_refs", "5").is_ok()
}

/// A value of `/proc/self/status` (bytes) by its name, such as `VmHWM:`, the peak memory use.
pub(crate) fn status(name: &str) -> Option<usize> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    Some(1024 * line.split_whitespace().next()?.parse::<usize>().ok()?)
}
