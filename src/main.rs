//! The program `posebridge`: parse, run, exit code.

use std::io::IsTerminal;
use std::process::ExitCode;

use posebridge::cli::{Cli, execute};
use posebridge::console::{LogWriter, print_line};
use posebridge::exit::survive_file_limits;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::{Layer, SubscriberExt};
use tracing_subscriber::util::SubscriberInitExt;

fn main() -> ExitCode {
    let cli = Cli::from_args();
    let log = tracing_subscriber::fmt::layer().with_writer(|| LogWriter).with_ansi(std::io::stderr().is_terminal());
    tracing_subscriber::registry().with(log.with_filter(log_filter())).init();
    if let Err(error) = survive_file_limits() {
        print_line(&format!("a file that may not grow will end the program: {error}"));
    }
    match execute(cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            print_line(&format!("posebridge: {:#}", failure.error()));
            ExitCode::from(failure.exit_code())
        }
    }
}

/// The levels of POSEBRIDGE_LOG, e.g. `warn,posebridge=info`; warnings and errors if it is unset or invalid.
fn log_filter() -> Targets {
    let levels = std::env::var("POSEBRIDGE_LOG").ok();
    levels.and_then(|levels| levels.parse().ok()).unwrap_or_else(|| Targets::new().with_default(LevelFilter::WARN))
}
