#!/usr/bin/env python3
"""Scores an estimate against the truth with evo, from files that `posebridge export RECORDING --format tum --out tables` wrote.

    python3 score.py tables/truth.tum tables/estimate.tum

In a notebook: `from score import score`. Nothing is aligned: both are in the arena, so an offset is an error.
The same on the command line: `evo_ape tum truth.tum estimate.tum`.
"""
import sys

from evo.core import metrics, sync
from evo.tools import file_interface


def score(truth, estimate):
    """The root mean square and the largest error of the position (m), and of the heading (rad)."""
    pair = (file_interface.read_tum_trajectory_file(truth), file_interface.read_tum_trajectory_file(estimate))
    pair = sync.associate_trajectories(*pair, max_diff=1e-6)
    figures = {}
    for name, relation in (
        ("position_m", metrics.PoseRelation.translation_part),
        ("heading_rad", metrics.PoseRelation.rotation_angle_rad),
    ):
        error = metrics.APE(relation)
        error.process_data(pair)
        figures[name] = {"rms": error.get_statistic(metrics.StatisticsType.rmse), "max": error.get_statistic(metrics.StatisticsType.max)}
    return figures


def main(truth, estimate):
    for name, figure in score(truth, estimate).items():
        print(f"{name:12} rms {figure['rms']:.6f}  max {figure['max']:.6f}")


if __name__ == "__main__":
    main(*sys.argv[1:])
