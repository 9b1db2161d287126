#!/usr/bin/env python3
"""Writes tables that `posebridge export LOG --messages --format csv` wrote as Parquet, `MESSAGE.parquet` beside each `MESSAGE.csv`.

    python3 messages_to_parquet.py drive-messages

The names of the columns stay, units and all; columns of whole numbers are integers, so DuckDB and Polars take them as they are.
"""
import pathlib
import sys

import pandas as pd


def convert(path):
    """Of the texts only NaN is a missing number: a parameter may be called NA."""
    table = pd.read_csv(path, keep_default_na=False, na_values=["NaN"])
    parquet = path.with_suffix(".parquet")
    table.to_parquet(parquet)
    return parquet, len(table)


def main(folder):
    for path in sorted(pathlib.Path(folder).glob("*.csv")):
        parquet, rows = convert(path)
        print(f"{rows} rows to {parquet}")


if __name__ == "__main__":
    main(*sys.argv[1:])
