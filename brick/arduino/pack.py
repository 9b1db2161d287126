#!/usr/bin/env python3
"""Makes the Arduino library: PosebridgeBrick.zip, for "Sketch > Include Library > Add .ZIP Library".

    python3 brick/arduino/pack.py [folder]        the zip is written there; here without an argument

The header is taken from brick/c, so that there is one of it. Needs Python 3 and nothing else.
"""

import sys
import zipfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
NAME = "PosebridgeBrick"
FILES = {
    HERE / "library.properties": "library.properties",
    HERE / "src/PosebridgeBrick.h": "src/PosebridgeBrick.h",
    HERE.parent / "c/posebridge_brick.h": "src/posebridge_brick.h",
    HERE / "examples/TwoWheels/TwoWheels.ino": "examples/TwoWheels/TwoWheels.ino",
}


def main():
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    path = folder / f"{NAME}.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for source, name in FILES.items():
            archive.write(source, f"{NAME}/{name}")
    print(path)


if __name__ == "__main__":
    main()
