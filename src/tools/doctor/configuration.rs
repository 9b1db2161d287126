//! Whether the configuration makes sense, and whether its links open.

use posebridge_link::{ConnectRole, HostTimer, LinkUrl};

use super::check_result::{CheckResult, DiagnosticContext};
use super::open::{OpenOutcome, open, rejected_result, run_in_runtime, unavailable_result};
use crate::config::{self, Config, LinkTarget, load_scenario};

/// Loads the configuration, then opens each link of a given file once and closes it.
pub fn check(examination: &DiagnosticContext) -> Vec<CheckResult> {
    let path = examination.config.as_deref();
    let name = path.map_or("the embedded default".to_owned(), |path| path.display().to_string());
    let loaded = match config::load(path, &[]) {
        Ok(loaded) => loaded,
        Err(error) => return vec![invalid_config(&error.to_string())],
    };
    let config = loaded.config;
    let targets = config.station_config().and_then(|_| config.targets());
    let targets = match targets {
        Ok(targets) => targets,
        Err(error) => return vec![invalid_config(&format!("{name}: {error:#}"))],
    };
    let mut verdicts = vec![CheckResult::ok(format!("{name} makes sense"))];
    if path.is_some() {
        verdicts.extend(open_links(&config, &targets));
    }
    verdicts
}

fn invalid_config(what: &str) -> CheckResult {
    CheckResult::problem(
        what,
        "correct it there; `posebridge config print` shows every key, config/default.toml explains them",
    )
}

fn open_links(config: &Config, targets: &[(LinkTarget, ConnectRole)]) -> Vec<CheckResult> {
    run_in_runtime(async {
        let timer = HostTimer::start();
        let mut verdicts = Vec::new();
        for ((target, role), section) in targets.iter().zip(&config.links) {
            let link = format!("link `{}`", section.url);
            verdicts.push(match target {
                LinkTarget::Sim(scenario) => check_scenario(&link, scenario),
                LinkTarget::Url(url) => open_link(&link, url, *role, timer).await,
            });
        }
        verdicts
    })
}

fn check_scenario(link: &str, scenario: &str) -> CheckResult {
    match load_scenario(scenario) {
        Ok(_) => CheckResult::ok(format!("{link} is simulated")),
        Err(error) => CheckResult::problem(
            format!("{link} cannot be simulated: {error:#}"),
            "docs/simulator.md, section 4, has the keys and the bundled scenarios",
        ),
    }
}

async fn open_link(link: &str, url: &LinkUrl, role: ConnectRole, timer: HostTimer) -> CheckResult {
    let scheme = url.transport().scheme();
    if !matches!(scheme, "serial" | "tcp" | "udp") {
        // To open one of these would make or change a file.
        return CheckResult::skipped(format!("{link} is not opened before the station runs"));
    }
    match open(url, role, timer).await {
        OpenOutcome::Up(_, detail) => CheckResult::ok(format!("{link} opens: {detail}")),
        OpenOutcome::Unavailable(reason) => unavailable_result(link, &reason),
        OpenOutcome::Rejected(error) => rejected_result(link, &error),
    }
}
