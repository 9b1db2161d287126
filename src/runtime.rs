//! The asynchronous runtime of a command.

/// Runs a future on this thread. An attempt to open a device that hangs does not keep the program alive.
pub(crate) fn run_in_runtime<T>(work: impl Future<Output = T>) -> std::io::Result<T> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let result = runtime.block_on(work);
    runtime.shutdown_background();
    Ok(result)
}
