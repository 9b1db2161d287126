"""line_widths.py FILE ..: fails if a line of any file is wider than a terminal of 80 columns.

A line without a space before column 80 cannot be broken: a path or a URL.
"""

import sys
from pathlib import Path

COLUMNS = 80
wide = [
    f"{path}:{number}: {len(line)} columns: {line}"
    for path in map(Path, sys.argv[1:])
    for number, line in enumerate(path.read_text().splitlines(), 1)
    if len(line) > COLUMNS and " " in line.strip()[:COLUMNS]
]
print(*wide, sep="\n", end="\n" if wide else "")
sys.exit(bool(wide))
