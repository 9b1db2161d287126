//! The set-up checklist of a robot, from a station that runs for some seconds.

use posebridge_report::setup_checklist::{ChecklistItem, StepState};

use super::context::{CheckResult, DiagnosticContext, Status};
use crate::console::print_line;
use crate::station::run;

/// A clock alignment, and a motion by hand, take longer than to name a protocol.
const MIN_DURATION_S: f64 = 10.0;

pub(super) fn check_setup(context: &DiagnosticContext) -> Vec<CheckResult> {
    let Some(robot) = &context.robot else {
        return vec![CheckResult::skipped("no robot is given: `--robot FILE` goes through its set-up")];
    };
    let duration_s = context.listen_for_s.max(MIN_DURATION_S);
    print_line(&format!("listening for {duration_s:.0} s: turn both wheels, or drive the robot"));
    match run::check_setup(robot, &context.links, duration_s) {
        Ok(setups) => {
            let is_one = setups.len() == 1;
            let results = setups.into_iter().flat_map(|(robot, items)| {
                let robot = robot.filter(|_| !is_one).map(|robot| format!("{} ", robot.path())).unwrap_or_default();
                items.into_iter().map(move |item| result_of(&robot, &item))
            });
            results.collect()
        }
        Err(failure) => vec![CheckResult::problem(
            format!("{:#}", failure.error()),
            "correct the file; `posebridge init --guide` writes one for your robot",
        )],
    }
}

fn result_of(robot: &str, item: &ChecklistItem) -> CheckResult {
    let status = match item.state {
        StepState::Done => Status::Ok,
        StepState::Optional => Status::Skipped,
        StepState::Waiting => Status::Warning,
        StepState::Problem => Status::Problem,
    };
    let message = format!("{robot}{}: {}", item.step.as_text(), item.figure);
    CheckResult { status, message, advice: item.advice.to_owned() }
}
