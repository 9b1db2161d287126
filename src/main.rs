//! The program `posebridge`: parse, run, exit code.

use std::process::ExitCode;

use clap::Parser;
use posebridge::cli::Cli;
use posebridge::commands::{self, Failure};

fn main() -> ExitCode {
    let cli = Cli::parse();
    tracing_subscriber::fmt()
        .with_env_filter(log_filter())
        .with_writer(std::io::stderr)
        .init();
    match commands::execute(cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            report(&failure);
            ExitCode::from(failure.exit_code())
        }
    }
}

/// What POSEBRIDGE_LOG asks for; without it warnings and errors.
fn log_filter() -> tracing_subscriber::EnvFilter {
    tracing_subscriber::EnvFilter::try_from_env("POSEBRIDGE_LOG")
        .unwrap_or_else(|_unset| tracing_subscriber::EnvFilter::new("warn"))
}

#[expect(
    clippy::print_stderr,
    reason = "the one place where a failure is told to a person"
)]
fn report(failure: &Failure) {
    eprintln!("posebridge: {:#}", failure.error());
}
