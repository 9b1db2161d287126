// Answers the commands of brick/vectors by the MicroPython module under a real MicroPython, its WebAssembly port.
//
//     node run_micropython.mjs <folder with @micropython/micropython-webassembly-pyscript> < commands
import { readFileSync } from "node:fs";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";

const here = dirname(fileURLToPath(import.meta.url));
const port = resolve(process.argv[2], "micropython.mjs");
const { loadMicroPython } = await import(pathToFileURL(port).href);
const python = await loadMicroPython({ stdout: (line) => console.log(line), linebuffer: true });
python.FS.writeFile("/posebridge_brick.py", readFileSync(join(here, "../micropython/posebridge_brick.py")));
python.FS.writeFile("/driver.py", readFileSync(join(here, "driver.py")));
python.runPython("import sys\nsys.path.append('/')\nassert sys.implementation.name == 'micropython'\nimport driver");
for (const line of readFileSync(0, "utf8").split("\n")) {
    if (line !== "") {
        python.globals.set("line", line);
        python.runPython("print(driver.answer(line))");
    }
}
