//! The program `posebridge`: parse, run, exit code.

use std::io::IsTerminal;
use std::process::ExitCode;

use clap::Parser;
use posebridge::cli::{Cli, execute};
use posebridge::console::{LogWriter, print_line};

fn main() -> ExitCode {
    let cli = Cli::parse();
    tracing_subscriber::fmt()
        .with_env_filter(log_filter())
        .with_writer(|| LogWriter)
        .with_ansi(std::io::stderr().is_terminal())
        .init();
    match execute(cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            print_line(&format!("posebridge: {:#}", failure.error()));
            ExitCode::from(failure.exit_code())
        }
    }
}

/// What POSEBRIDGE_LOG asks for; without it warnings and errors.
fn log_filter() -> tracing_subscriber::EnvFilter {
    tracing_subscriber::EnvFilter::try_from_env("POSEBRIDGE_LOG")
        .unwrap_or_else(|_unset| tracing_subscriber::EnvFilter::new("warn"))
}
