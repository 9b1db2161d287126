// Runs posebridge_filters.py over rows under a real MicroPython, its WebAssembly port.
//
//     node run_micropython.mjs <folder with @micropython/micropython-webassembly-pyscript> <filter> < rows
import { readFileSync } from "node:fs";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const port = resolve(process.argv[2], "micropython.mjs");
const { loadMicroPython } = await import(pathToFileURL(port).href);
const python = await loadMicroPython({ stdout: (line) => console.log(line), linebuffer: true });
python.FS.writeFile("/posebridge_filters.py", readFileSync(join(here, "../../micropython/posebridge_filters.py")));
python.FS.writeFile("/steps.py", readFileSync(join(here, "steps.py")));
python.globals.set("title", process.argv[3]);
python.globals.set("text", readFileSync(0, "utf8"));
python.runPython(`
import sys
sys.path.append('/')
assert sys.implementation.name == 'micropython'
import steps
rows = [[float(word) for word in line.split()] for line in text.split('\\n') if line]
for answer in steps.answers(title, rows):
    print(' '.join(repr(value) for value in answer))
`);
