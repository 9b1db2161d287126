//! The filters of the experiment, and the report over all of them.

use posebridge_estimator::FilterConfig;
use posebridge_lab::square::{
    Method, MethodRanking, PaperInterpretation, PathErrors, SensorTable, SquareExample, SquareReport,
    corrected_methods, extended, noise_at_stop, noise_on_straight, prepare_config, printed_methods, swapped_methods,
};

/// Every method once: the paper's chain, the corrected one, the outlook.
fn groups() -> [(&'static str, Vec<Method>); 4] {
    [
        ("the paper's matrices", printed_methods()),
        ("matrices that follow from the sensors", corrected_methods()),
        ("the paper's matrices, Q of v and w swapped", swapped_methods()),
        ("outlook", extended()),
    ]
}

/// Cuts the errors of all methods, in the order of [`groups`], into chains.
fn chains(runs: &[Vec<PathErrors>]) -> (Vec<MethodRanking>, MethodRanking) {
    let mut from = 0;
    let mut all: Vec<MethodRanking> = Vec::new();
    for (setting, methods) in groups() {
        let to = from + methods.len();
        let runs = runs.iter().filter_map(|run| Some(run.get(from..to)?.to_vec()));
        all.push(MethodRanking {
            matrices: setting,
            names: methods.iter().map(|method| method.name).collect(),
            runs: runs.collect(),
        });
        from = to;
    }
    let outlook = all.pop().unwrap_or(MethodRanking { matrices: "outlook", names: Vec::new(), runs: Vec::new() });
    (all, outlook)
}

pub(super) fn every_method() -> Vec<Method> {
    groups().into_iter().flat_map(|(_, methods)| methods).collect()
}

pub(super) fn example(table: SensorTable, base: &FilterConfig, camera_every: usize) -> SquareExample {
    let config = prepare_config(&table, base);
    let paths = every_method().into_iter().map(|method| {
        let path = method.run(&table, &config, camera_every);
        (method.name, path)
    });
    SquareExample { paths: paths.collect(), table, config, camera_every }
}

pub(super) fn report(
    source: String,
    command: String,
    runs: &[Vec<PathErrors>],
    readings: Vec<PaperInterpretation>,
    example: SquareExample,
) -> SquareReport {
    let (chains, outlook) = chains(runs);
    SquareReport {
        source,
        command,
        rankings: chains,
        extended: outlook,
        interpretations: readings,
        stop: noise_at_stop(&example.table, example.geometry()),
        straight: noise_on_straight(&example.table, example.geometry()),
        example,
    }
}
