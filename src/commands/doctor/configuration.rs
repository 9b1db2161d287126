//! Whether the configuration makes sense, and whether its links open.

use posebridge_link::{HostTimer, LinkUrl, Role};

use super::open::{Opened, away, on_a_runtime, open, refused};
use super::{Examination, Verdict};
use crate::config::{self, Config};
use crate::link_target::{LinkTarget, load_scenario};

/// Loads the configuration, then opens each link of a given file once and closes it.
#[must_use]
pub fn check(examination: &Examination) -> Vec<Verdict> {
    let path = examination.config.as_deref();
    let name = path.map_or("the embedded default".to_owned(), |path| path.display().to_string());
    let loaded = match config::load(path, &[]) {
        Ok(loaded) => loaded,
        Err(error) => return vec![wrong(&error.to_string())],
    };
    let config = loaded.config;
    let targets = config.pipeline().and_then(|_pipeline| config.targets());
    let targets = match targets {
        Ok(targets) => targets,
        Err(error) => return vec![wrong(&format!("{name}: {error:#}"))],
    };
    let mut verdicts = vec![Verdict::ok(format!("{name} makes sense"))];
    if path.is_some() {
        verdicts.extend(open_links(&config, &targets));
    }
    verdicts
}

fn wrong(what: &str) -> Verdict {
    Verdict::problem(
        what,
        "correct it there; `posebridge config print` shows every key, config/default.toml explains them",
    )
}

fn open_links(config: &Config, targets: &[(LinkTarget, Role)]) -> Vec<Verdict> {
    on_a_runtime(async {
        let timer = HostTimer::start();
        let mut verdicts = Vec::new();
        for ((target, role), section) in targets.iter().zip(&config.links) {
            let link = format!("link `{}`", section.url);
            verdicts.push(match target {
                LinkTarget::Sim(scenario) => judge_scenario(&link, scenario),
                LinkTarget::Url(url) => open_link(&link, url, *role, timer).await,
            });
        }
        verdicts
    })
}

fn judge_scenario(link: &str, scenario: &str) -> Verdict {
    match load_scenario(scenario) {
        Ok(_) => Verdict::ok(format!("{link} is simulated")),
        Err(error) => Verdict::problem(
            format!("{link} cannot be simulated: {error:#}"),
            "docs/simulated-brick.md, section 4, has the keys and the bundled scenarios",
        ),
    }
}

async fn open_link(link: &str, url: &LinkUrl, role: Role, timer: HostTimer) -> Verdict {
    let scheme = url.transport().scheme();
    if !matches!(scheme, "serial" | "tcp" | "udp") {
        // To open one of these would make or change a file.
        return Verdict::skipped(format!("{link} is not opened before the station runs"));
    }
    match open(url, role, timer).await {
        Opened::Up(_, detail) => Verdict::ok(format!("{link} opens: {detail}")),
        Opened::Away(reason) => away(link, &reason),
        Opened::Refused(error) => refused(link, &error),
    }
}
