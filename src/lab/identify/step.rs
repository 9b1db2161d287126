//! `posebridge identify step`: gain, dead time and lags of a sensor or a motor, from the samples of one step or several.
//!
//! Without a recording on a simulated sensor whose numbers are known. docs/lab/calibration.md, section 7, has the equations.

use anyhow::{Context, Result};
use posebridge_lab::identification::{StepParameters, identify_step};

use super::report::write_findings;
use super::step_args::StepArgs;
use super::step_dataset::StepRun;
use super::step_report::{self, StepResult};
use super::step_source;
use crate::console::progress_bar;
use crate::exit::{ExitStage, Failure};
use crate::lab::parallel::run_all;

/// Identifies.
///
/// # Errors
/// The recording cannot be had, holds no step, or an output cannot be written.
pub(super) fn execute(args: &StepArgs) -> Result<(), Failure> {
    let material = step_source::load(args).before_start()?;
    let folder = args.output.folder()?;
    let bar = progress_bar(material.runs.len() as u64, "steps").before_start()?;
    let found = run_all(&material.runs, identify_run_step, || bar.inc(1));
    bar.finish_and_clear();
    let found: Vec<StepResult> = found.into_iter().collect::<Result<_>>().while_running()?;
    let findings = step_report::findings(&material, &found);
    write_findings(&args.output, &folder, &findings, &material.source)
}

fn identify_run_step(run: &StepRun) -> Result<StepResult> {
    let identified = identify_step(&run.samples, &run.options).with_context(|| {
        format!("run `{}`; cut the step out with --from and --to, or give its noise with --noise", run.name)
    })?;
    Ok(StepResult {
        numbers: StepParameters::from_step(&identified, run.options.input_step, run.sampling),
        identified,
        run: run.clone(),
    })
}
