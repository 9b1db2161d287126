#!/usr/bin/env python3
"""Reads tables that `posebridge export RECORDING --format csv --out tables` wrote: says how each sensor did and draws the path.

    python3 read_tables.py tables [path.png]

In a notebook: `from read_tables import sensors, path`. The columns are those of docs/recordings.md; their names end in their units.
"""
import pathlib
import sys

import matplotlib
import pandas as pd


def sensors(folder):
    """Of each sensor: observations, the share that was used, and the mean NIS per degree of freedom, which is 1 for an honest filter."""
    fusion = pd.read_csv(pathlib.Path(folder) / "fusion.csv")
    # Slip is seen in what was used all the same, and so is a reset.
    fusion["used"] = fusion["verdict"].isin(["accepted", "slip", "reset to"])
    of_each = fusion.groupby("sensor_name")
    judged = fusion[fusion["used"] & (fusion["degrees_of_freedom"] > 0)].groupby("sensor_name")
    return pd.DataFrame({
        "observations": of_each.size(),
        "used": of_each["used"].mean(),
        "nis_per_dof": judged["nis"].sum() / judged["degrees_of_freedom"].sum(),
    })


def path(folder):
    """Where the robot has been, with one standard deviation of each coordinate, by the robot's clock."""
    estimates = pd.read_csv(pathlib.Path(folder) / "estimates.csv")
    estimates = estimates[estimates["position_valid"] == 1]
    return pd.DataFrame({
        "t_s": estimates["t_s"],
        "x_m": estimates["x_m"],
        "y_m": estimates["y_m"],
        "x_sigma_m": estimates["var_x_m2"] ** 0.5,
        "y_sigma_m": estimates["var_y_m2"] ** 0.5,
    }).set_index("t_s")


def main(folder, picture="path.png"):
    print(sensors(folder).to_string(float_format="{:.3f}".format))
    # No window: a script may run where there is no screen.
    matplotlib.use("agg")
    axes = path(folder).plot(x="x_m", y="y_m", legend=False, xlabel="x, m", ylabel="y, m")
    axes.set_aspect("equal")
    axes.figure.savefig(picture, dpi=150)
    print(f"path to {picture}")


if __name__ == "__main__":
    main(*sys.argv[1:])
