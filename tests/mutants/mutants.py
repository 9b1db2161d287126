#!/usr/bin/env python3
"""Mutation tests from one build: each sampled mutant is compiled behind a switch at run time. See README.md."""

import argparse
import collections
import concurrent.futures
import difflib
import hashlib
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parents[1]
SEED = 20261124
SWITCH = "posebridge_mutant_switch"
CAPACITY = 1 << 16  # of the switch
NOT_MUTATED = {"posebridge-fuzz-bodies"}
# Lints that the compiler denies by itself, and that a mutant may violate.
DENIED_BY_DEFAULT = [
    "arithmetic_overflow", "unconditional_panic", "overflowing_literals", "unsafe_code", "unconditional_recursion",
    "never_type_fallback_flowing_into_unsafe", "invalid_reference_casting", "let_underscore_lock",
]


def log(*words):
    print(time.strftime("%H:%M:%S"), *words, flush=True)


def load(path, default=None):
    if not path.exists() and default is not None:
        return default
    return json.loads(path.read_text())


def store(path, value):
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(path.suffix + ".part")
    part.write_text(json.dumps(value, indent=1))
    part.rename(path)


def output_of(*command, **options):
    done = subprocess.run(command, capture_output=True, text=True, **options)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command[:4]))} failed:\n{done.stderr}")
    return done.stdout


class Tree:
    """A commit in a clone of its own, with everything that is known of it."""

    def __init__(self, work, commit):
        self.work = work
        self.commit = output_of("git", "-C", REPOSITORY, "rev-parse", "--verify", commit + "^{commit}").strip()
        self.state = work / "commits" / self.commit[:12]
        self.path = self.state / "clone"
        self.target = self.state / "target"
        self.results = self.state / "results.jsonl"

    def prepare(self):
        """Makes the clone, or undoes what an interrupted run left in it."""
        if not self.path.exists():
            self.state.mkdir(parents=True, exist_ok=True)
            part = self.state / "clone.part"
            shutil.rmtree(part, ignore_errors=True)
            output_of("git", "clone", "-q", "--no-checkout", REPOSITORY, part)
            output_of("git", "-C", part, "checkout", "-q", "--detach", self.commit)
            part.rename(self.path)
        self.restore()
        command = ["cargo", "metadata", "--format-version", "1", "--no-deps"]
        packages = json.loads(output_of(*command, cwd=self.path))["packages"]
        self.packages = {p["name"]: p for p in packages if p["name"] not in NOT_MUTATED}

    def git(self, *words):
        return output_of("git", "-C", self.path, *words)

    def restore(self):
        self.git("checkout", "-q", "--", ".")

    def mutants(self):
        """All mutants, with the text they change and whether they can be put behind the switch."""
        path = self.state / "mutants.json"
        if path.exists():
            return load(path)
        log("listing the mutants of", self.commit[:12])
        command = ["cargo", "mutants", "--list", "--json", "--no-config"]
        for package in self.packages:
            command += ["-p", package]
        seen = set()
        mutants = []
        lines = {}
        for one in json.loads(output_of(*command, cwd=self.path)):
            start = one["span"]["start"]
            function = one["function"] or {}
            name = function.get("function_name", "")
            place = (one["file"], start["line"], start["column"], one["genre"], one["replacement"], name)
            # A program and its library may list the same file.
            if place in seen or re.search(r"(^|/)(tests|benches|examples)/", one["file"]):
                continue
            seen.add(place)
            if one["file"] not in lines:
                lines[one["file"]] = (self.path / one["file"]).read_text().split("\n")
            mutants.append({
                "id": len(mutants) + 1, "package": one["package"], "file": one["file"], "line": start["line"],
                "col": start["column"], "function": name, "returns": function.get("return_type", ""),
                "genre": one["genre"], "replacement": one["replacement"], "name": one["name"],
                "original": original_text(one, lines[one["file"]]), "diff": one["diff"],
            })
        answer = self.instrument("describe", self.path, mutants)
        store(self.state / "needed_const.json", answer["const"])
        for one in mutants:
            description = answer["described"][str(one["id"])]
            one["text"] = description["text"] or ""
            one["refused"] = description["reason"]
        count_equals(mutants)
        store(path, mutants)
        return mutants

    def instrument(self, mode, where, mutants, keep_const=()):
        target = self.work / "instrument"
        manifest = HERE / "instrument/Cargo.toml"
        output_of("cargo", "build", "-q", "--locked", "--manifest-path", manifest, "--target-dir", target)
        files = collections.defaultdict(list)
        for one in mutants:
            files[one["file"]].append({key: one[key] for key in ("id", "genre", "line", "col", "replacement")})
        # Which functions constants need takes a look at all sources: once.
        needed = load(self.state / "needed_const.json", []) if mode == "apply" else []
        plan = self.state / "instrument-in.json"
        answer = self.state / "instrument-out.json"
        sources = self.git("ls-files", "*.rs").splitlines()
        store(plan, {"files": files, "sources": sources, "keep_const": list(keep_const), "needed": needed})
        output_of(target / "debug/instrument", mode, where, plan, answer)
        return load(answer)


def original_text(one, lines):
    """What the mutation changes; nothing for the value of a function."""
    if one["genre"] == "FnValue":
        return ""
    if one["genre"] == "MatchArm":
        found = re.search(r": delete match arm (.*)$", one["name"], re.S)
        return found.group(1) if found else ""
    start, end = one["span"]["start"], one["span"]["end"]
    if start["line"] == end["line"]:
        return lines[start["line"] - 1][start["column"] - 1:end["column"] - 1]
    text = "\n".join(lines[start["line"] - 1:end["line"]])
    rest = len(lines[end["line"] - 1]) - (end["column"] - 1)
    return " ".join(text[start["column"] - 1:len(text) - rest].split())


# ---- Samples


def identity(m):
    return (m["package"], m["function"], m["genre"], m["original"], m["replacement"])


def position(m):
    return (m["file"], m["line"], m["col"], m["id"])


# How a mutant is recognised in another commit; the strictest first.
SAME = [
    ("same place", lambda m: (m["file"], *identity(m), m["text"])),
    ("same function", lambda m: (*identity(m), m["text"])),
]


def count_equals(mutants):
    """Gives each mutant its key, and its rank among equal expressions, so that these keep their order."""
    counts = collections.Counter()
    for m in sorted(mutants, key=position):
        counts[identity(m)] += 1
        m["key"] = " | ".join([*identity(m), str(counts[identity(m)])])
    for how, key_of in SAME:
        counts = collections.Counter()
        for m in sorted(mutants, key=position):
            if not m["refused"]:
                m.setdefault("rank", {})[how] = counts[key_of(m)]
                counts[key_of(m)] += 1


def moved_key(m, within_package):
    package = m["package"] if within_package else ""
    signature = (m["function"].split("::")[-1], m["returns"]) if m["genre"] == "FnValue" else ()
    return (package, m["genre"], signature, m["original"], m["replacement"], m["text"])


def locate(sample, mutants):
    """Finds each mutant of the sample in another commit: {key: (mutant, how it was recognised)}."""
    free = {m["id"]: m for m in mutants if not m["refused"]}
    found = {}

    def take(m, candidates, how):
        for one in candidates:
            if one["id"] in free:
                found[m["key"]] = (one, how)
                del free[one["id"]]
                return

    for how, key_of in SAME:
        index = collections.defaultdict(list)
        for m in sorted(mutants, key=position):
            if not m["refused"]:
                index[key_of(m)].append(m)
        for m in sample:
            if m["key"] not in found:
                equals = index[key_of(m)]
                rank = m["rank"][how]
                take(m, equals[rank:rank + 1] + equals, how)
    for how, within_package in (("moved within the package", True), ("moved to another package", False)):
        index = collections.defaultdict(list)
        for m in free.values():
            index[moved_key(m, within_package)].append(m)
        for m in sample:
            distinctive = len(m["text"]) >= 8 or m["genre"] == "FnValue"
            equals = index[moved_key(m, within_package)]
            if m["key"] not in found and distinctive and len(equals) == 1:
                take(m, equals, how)
    # The same operator in the same function in a changed expression: the most similar.
    for m in sample:
        if m["key"] in found or m["genre"] == "FnValue":
            continue
        similar = [n for n in free.values() if identity(n) == identity(m)]
        ratios = [(difflib.SequenceMatcher(None, m["text"], n["text"]).ratio(), -n["id"], n) for n in similar]
        if ratios and max(ratios)[0] >= 0.6:
            take(m, [max(ratios)[2]], "similar expression")
    return found


def read_samples(work):
    samples = {path.stem: load(path)["mutants"] for path in sorted((work / "samples").glob("*.json"))}
    if not samples:
        sys.exit("there is no sample: mutants.py sample COMMIT")
    return samples


def command_sample(arguments):
    tree = Tree(arguments.work, arguments.commit)
    tree.prepare()
    mutants = tree.mutants()
    for package in arguments.package or tree.packages:
        own = sorted((m for m in mutants if m["package"] == package), key=lambda m: m["key"])
        if not own:
            log(f"{package}: no mutants")
            continue
        random.Random(SEED).shuffle(own)
        refused = collections.Counter(m["refused"] for m in own if m["refused"])
        sample = [m for m in own if not m["refused"]][:arguments.number]
        store(tree.work / "samples" / f"{package}.json", {"commit": tree.commit, "seed": SEED, "mutants": sample})
        log(f"{package}: {len(sample)} of {len(own)} mutants; not instrumentable: {dict(refused)}")


# ---- Build


def write_instrumented(tree, mutants, keep_const):
    """Instruments an export of the commit and copies to the clone only what differs; returns the places of mutants."""
    stage = tree.state / "stage"
    shutil.rmtree(stage, ignore_errors=True)
    stage.mkdir(parents=True)
    archive = tree.state / "stage.tar"
    tree.git("archive", "-o", str(archive), "HEAD", "--", "*.rs", "*Cargo.toml")
    output_of("tar", "-xf", archive, "-C", stage)
    answer = tree.instrument("apply", stage, mutants, keep_const)
    dependency = f"[dependencies]\n{SWITCH} = {{ path = {json.dumps(str(HERE / 'switch'))} }}\n"
    for package in tree.packages.values():
        path = stage / Path(package["manifest_path"]).relative_to(tree.path)
        text = path.read_text()
        if re.search(r"^\[dependencies\]\n", text, re.M):
            text = re.sub(r"^\[dependencies\]\n", lambda _: dependency, text, count=1, flags=re.M)
        else:
            text += "\n" + dependency
        path.write_text(text)
    path = stage / "Cargo.toml"
    text = re.sub(r"^\[workspace\.lints\.[a-z]+\]\n(?:(?!\[).*\n)*", "", path.read_text(), flags=re.M)
    text += '\n[workspace.lints.rust]\nwarnings = { level = "allow", priority = -1 }\n'
    text += "".join(f'{name} = "allow"\n' for name in DENIED_BY_DEFAULT)
    path.write_text(text)
    for path in stage.rglob("*"):
        destination = tree.path / path.relative_to(stage)
        if path.is_file() and (not destination.exists() or destination.read_bytes() != path.read_bytes()):
            destination.write_bytes(path.read_bytes())
    return answer["spans"]


def error_places(message, tree):
    """[(is secondary, file, start, end)] of a compiler's message, through its macros, the primary ones first."""
    places = []
    for span in message["spans"]:
        while span:
            file = os.path.relpath(os.path.join(tree.path, span["file_name"]), tree.path)
            places.append((not span["is_primary"], file, span["byte_start"], span["byte_end"]))
            span = (span.get("expansion") or {}).get("span")
    for child in message.get("children", ()):
        places += error_places(child, tree)
    return sorted(places, key=lambda place: place[0])


def mutants_of_error(message, spans, tree):
    """The mutants that a compiler error comes from."""
    places = error_places(message, tree)
    # In the branch of a mutant, else in an expression that has one: the smallest.
    for kind in ("m", "n"):
        around = []
        for _, file, at, _ in places:
            for number, which, start, end in spans.get(file, ()):
                if which == kind and start <= at < max(end, start + 1):
                    around.append((end - start, file, start, number))
        if around:
            smallest = min(around)[:3]
            return {number for *place, number in around if tuple(place) == smallest}
    # A match that lost an arm, a type that can't be inferred: what lies inside.
    for _, file, start, end in places:
        inside = {number for number, _, first, last in spans.get(file, ()) if start <= first and last <= end}
        if inside:
            return inside
    for _, file, _, end in places:
        before = [(first, number) for number, _, first, _ in spans.get(file, ()) if first <= end]
        if before:
            return {max(before)[1]}
    return set()


def build_once(tree, scope, spans):
    """(exit code, artifacts, mutants that do not compile, functions to keep constant, unexplained errors)"""
    command = ["cargo", "build", *scope, "--bins", "--tests", "--keep-going", "--message-format=json"]
    messages = tree.state / "build.jsonl"
    environment = dict(os.environ, CARGO_TARGET_DIR=str(tree.target))
    with open(messages, "w") as out, open(tree.state / "build.log", "w") as errors:
        code = subprocess.run(command, cwd=tree.path, env=environment, stdout=out, stderr=errors).returncode
    artifacts, unviable, keep_const, unexplained = [], {}, set(), []
    for line in messages.read_text().splitlines():
        one = json.loads(line) if line.startswith("{") else {}
        if one.get("reason") == "compiler-artifact":
            artifacts.append(one)
        message = one.get("message")
        if one.get("reason") != "compiler-message" or not message["level"].startswith("error"):
            continue
        if message["message"].startswith(("aborting due to", "could not compile")):
            continue
        error = (message.get("code") or {}).get("code") or ""
        if error == "E0015":  # A constant calls a function that lost its `const`.
            found = re.search(r"non-const (?:associated )?(?:function|method) `([^`]+)`", message["message"])
            name = re.sub(r"<.*>", "", found.group(1)).split("::")[-1] if found else None
            if name and name != "on":
                keep_const.add(name)
                continue
        numbers = mutants_of_error(message, spans, tree)
        for number in numbers:
            unviable.setdefault(number, f"{error} {message['message']}"[:200])
        if not numbers:
            unexplained.append(message.get("rendered") or message["message"])
    return code, artifacts, unviable, keep_const, unexplained


def build(tree, samples):
    """Builds all test programs with the sample's mutants, and drops mutants until it compiles. Returns the plan."""
    sample = [m for mutants in samples.values() for m in mutants]
    digest = hashlib.sha256("\n".join(m["key"] for m in sample).encode()).hexdigest()
    path = tree.state / "plan.json"
    if load(path, {"sample": ""})["sample"] == digest:
        return load(path)
    found = locate(sample, tree.mutants())
    gone = [{"key": m["key"], "name": m["name"], "why": "its code is gone"} for m in sample if m["key"] not in found]
    mutants = [dict(m, id=number, sample_key=key, found=how) for number, (key, (m, how)) in enumerate(found.items(), 1)]
    if len(mutants) >= CAPACITY:
        sys.exit(f"the switch has room for {CAPACITY - 1} mutants: draw a smaller sample")
    log(f"{len(mutants)} of {len(sample)} mutants of the sample are in {tree.commit[:12]}")
    scope = [word for package in sorted({m["package"] for m in mutants}) for word in ("-p", package)]
    # What earlier rounds found out stays, so that an interrupted build may be started again.
    known = load(tree.state / "unviable.json", {})
    keep_const = set(load(tree.state / "keep_const.json", []))
    while True:
        viable = [m for m in mutants if m["key"] not in known]
        spans = write_instrumented(tree, viable, keep_const)
        begin = time.monotonic()
        code, artifacts, unviable, more, unexplained = build_once(tree, scope, spans)
        log(f"build: {len(viable)} mutants, {len(unviable)} of them do not compile, {time.monotonic() - begin:.0f} s")
        if code == 0:
            break
        if not unviable and more <= keep_const:
            sys.exit("the build failed:\n" + "\n".join(unexplained[:5]) + f"\nsee {tree.state}/build.log")
        keep_const |= more
        known |= {m["key"]: unviable[m["id"]] for m in viable if m["id"] in unviable}
        store(tree.state / "unviable.json", known)
        store(tree.state / "keep_const.json", sorted(keep_const))
    tree.restore()  # Tests that read sources or manifests get those of the commit.
    names = {package["manifest_path"]: name for name, package in tree.packages.items()}
    programs = [
        {"package": names[one["manifest_path"]], "target": one["target"]["name"], "path": one["executable"]}
        for one in artifacts
        if one.get("executable") and one["profile"]["test"] and one["manifest_path"] in names
    ]
    for m in mutants:
        if m["key"] in known:
            gone.append({"key": m["sample_key"], "name": m["name"], "why": f"does not compile: {known[m['key']]}"})
    (tree.state / "baseline.json").unlink(missing_ok=True)  # It has the numbers of the last plan.
    store(tree.state / "gone.json", gone)
    store(path, {"sample": digest, "mutants": viable, "programs": programs})
    return load(path)


# ---- Tests


class Tests:
    """Runs tests from their programs, without cargo."""

    def __init__(self, tree, programs):
        self.tree = tree
        self.programs = programs
        self.scratch = Path(tempfile.mkdtemp(prefix="mutants-"))
        # What a mutant may take of the machine.
        resource.setrlimit(resource.RLIMIT_AS, (12 << 30, 12 << 30))
        resource.setrlimit(resource.RLIMIT_FSIZE, (2 << 30, 2 << 30))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

    def environment(self, package, more):
        about = self.tree.packages[package]
        environment = {k: v for k, v in os.environ.items() if not k.startswith("POSEBRIDGE_MUTANT")}
        environment |= {
            "CARGO": shutil.which("cargo") or "cargo", "CARGO_TARGET_DIR": str(self.tree.target),
            "CARGO_MANIFEST_DIR": str(Path(about["manifest_path"]).parent),
            "CARGO_MANIFEST_PATH": about["manifest_path"],
            "INSTA_UPDATE": "no", "PROPTEST_DISABLE_FAILURE_PERSISTENCE": "1", "PROPTEST_MAX_SHRINK_ITERS": "0",
            "PROPTEST_RNG_SEED": str(SEED), "RUST_BACKTRACE": "0", "TMPDIR": str(self.scratch),
        }
        for target in about["targets"]:
            if "bin" in target["kind"]:
                environment["CARGO_BIN_EXE_" + target["name"]] = str(self.tree.target / "debug" / target["name"])
        return environment | {key: str(value) for key, value in more.items()}

    def run(self, package, program, words, limit, **more):
        """(exit code or None at the time limit, output, seconds)"""
        begin = time.monotonic()
        path = self.scratch / f"output-{threading.get_ident()}"
        # To a file: a child that outlives its test would hold a pipe open.
        with open(path, "wb") as out:
            process = subprocess.Popen(
                [program, *words], cwd=Path(self.tree.packages[package]["manifest_path"]).parent,
                env=self.environment(package, more), stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT,
                start_new_session=True)
            try:
                code = process.wait(limit)
            except subprocess.TimeoutExpired:
                code = None
            try:
                os.killpg(process.pid, signal.SIGKILL)
            except (ProcessLookupError, PermissionError):
                pass
            process.wait()
        with open(path, "rb") as file:
            output = file.read(4_000_000).decode(errors="replace")
        return code, output, time.monotonic() - begin

    def run_alone(self, test, limit, **more):
        return self.run(test["package"], test["program"], ["--exact", test["name"], "--test-threads=1"], limit, **more)

    def names(self, program, *words):
        words = ["--list", "--format", "terse", *words]
        code, output, _ = self.run(program["package"], program["path"], words, 60)
        if code != 0:
            sys.exit(f"{program['path']} --list: {output[-500:]}")
        return [line.removesuffix(": test") for line in output.splitlines() if line.endswith(": test")]

    def listed(self, package):
        tests = []
        for one in self.programs:
            if one["package"] == package:
                ignored = set(self.names(one, "--ignored"))
                tests += [{"package": package, "program": one["path"], "target": one["target"], "name": name}
                          for name in self.names(one) if name not in ignored]
        return tests

    def clean(self):
        shutil.rmtree(self.scratch, ignore_errors=True)
        self.scratch.mkdir(exist_ok=True)


def measure_baseline(tests, package, jobs):
    """Runs each test alone without a mutant: does it pass, how long does it take, which mutants does it reach?"""

    def once(test):
        record = tests.scratch / ("reached-" + hashlib.sha1(repr(test).encode()).hexdigest())
        for _ in range(2):  # A test that depends on time may fail once on a busy machine.
            record.unlink(missing_ok=True)
            code, output, seconds = tests.run_alone(test, 600, POSEBRIDGE_MUTANT_RECORD=record)
            if code == 0:
                break
        data = record.read_bytes() if record.exists() else b""
        reached = sorted({int.from_bytes(data[at:at + 4], "little") for at in range(0, len(data), 4)})
        if code != 0:
            log(f"fails without a mutant, left out: {package} {test['target']} {test['name']}\n{output[-400:]}")
        return dict(test, passes=code == 0, seconds=round(seconds, 4), reached=reached)

    listed = tests.listed(package)
    with concurrent.futures.ThreadPoolExecutor(jobs) as pool:
        done = list(pool.map(once, listed))
    tests.clean()
    log(f"{package}: {sum(t['passes'] for t in done)} of {len(done)} tests pass without a mutant")
    return done


def batches(tests):
    """Quick tests first; those of one program and of similar duration together in one process."""
    groups = collections.defaultdict(list)
    for test in tests:
        duration = sum(test["seconds"] > step for step in (0.05, 0.2, 1.0, 4.0))
        groups[(duration, test["program"])].append(test)
    for key in sorted(groups, key=lambda key: (key[0], sum(t["seconds"] for t in groups[key]))):
        batch = []
        total = 0.0
        for test in sorted(groups[key], key=lambda t: t["seconds"]):
            if batch and (total + test["seconds"] > 2.0 or len(batch) >= 400):
                yield batch
                batch = []
                total = 0.0
            batch.append(test)
            total += test["seconds"]
        yield batch


def try_mutant(tests, number, chosen):
    """(caught, missed or timeout; the first test that failed)"""
    for batch in batches(chosen):
        names = [t["name"] for t in batch]
        limit = 3 * sum(t["seconds"] for t in batch) + 20
        words = ["--exact", *names, "--test-threads=1"]
        code, output, _ = tests.run(batch[0]["package"], batch[0]["program"], words, limit, POSEBRIDGE_MUTANT=number)
        if code == 0:
            continue
        passed = set(re.findall(r"^test (\S+)(?: - should panic)? \.\.\. ok$", output, re.M))
        failed = re.findall(r"^test (\S+)(?: - should panic)? \.\.\. FAILED$", output, re.M)
        # Without a failed test, the program died or hangs in the first that did not pass.
        suspects = failed or [name for name in names if name not in passed][:1] or names[:1]
        if code is None:
            return "timeout", f"{batch[0]['package']} {batch[0]['target']} {suspects[0]}"
        # A failure counts if the test fails alone, too; otherwise all of the batch are tried alone.
        ordered = [t for t in batch if t["name"] in suspects[:3]] + batch
        for test in ordered:
            code, _, _ = tests.run_alone(test, 3 * test["seconds"] + 20, POSEBRIDGE_MUTANT=number)
            if code != 0:
                return "timeout" if code is None else "caught", f"{test['package']} {test['target']} {test['name']}"
    return "missed", None


def read_results(tree):
    """The last result of each mutant."""
    lines = tree.results.read_text().splitlines() if tree.results.exists() else []
    return {one["key"]: one for one in map(json.loads, lines)}


def command_run(arguments):
    tree = Tree(arguments.work, arguments.commit)
    tree.prepare()
    samples = read_samples(tree.work)
    if arguments.package:
        unknown = set(arguments.package) - set(samples)
        if unknown:
            sys.exit(f"no sample of {', '.join(sorted(unknown))}")
        samples = {package: samples[package] for package in arguments.package}
    plan = build(tree, samples)
    tests = Tests(tree, plan["programs"])
    baseline = load(tree.state / "baseline.json", {})
    lock = threading.Lock()

    def once(mutant):
        chosen = [t for t in baseline[mutant["package"]] if t["passes"] and mutant["id"] in t["reached"]]
        result, test = try_mutant(tests, mutant["id"], chosen)
        record = {key: mutant[key] for key in ("package", "name", "file", "line", "found", "diff")}
        record |= {"key": mutant["sample_key"], "result": result, "test": test, "reached_by": len(chosen)}
        with lock, open(tree.results, "a") as out:
            out.write(json.dumps(record) + "\n")

    try:
        for package in sorted({m["package"] for m in plan["mutants"]}):
            if package not in baseline:
                baseline[package] = measure_baseline(tests, package, arguments.jobs)
                store(tree.state / "baseline.json", baseline)
            done = read_results(tree)
            left = [m for m in plan["mutants"] if m["package"] == package and m["sample_key"] not in done]
            log(f"{package}: {len(left)} mutants to try")
            with concurrent.futures.ThreadPoolExecutor(arguments.jobs) as pool:
                list(pool.map(once, left))
            tests.clean()
    finally:
        shutil.rmtree(tests.scratch, ignore_errors=True)
    print_summary(tree, samples)


# ---- Reports


def print_summary(tree, samples):
    results = read_results(tree)
    gone = {one["key"] for one in load(tree.state / "gone.json", [])}
    print(f"{'package':24}" + "".join(f"{h:>10}" for h in "sampled gone caught timeout missed unreached share".split()))
    missed = []
    for package, sample in samples.items():
        own = [results[m["key"]] for m in sample if m["key"] in results]
        counts = collections.Counter(one["result"] for one in own)
        missed += [one for one in own if one["result"] == "missed"]
        unreached = sum(one["result"] == "missed" and not one["reached_by"] for one in own)
        share = (counts["caught"] + counts["timeout"]) / max(len(own), 1)
        vanished = sum(m["key"] in gone for m in sample)
        print(f"{package:24}{len(sample):10}{vanished:10}{counts['caught']:10}{counts['timeout']:10}"
              f"{counts['missed']:10}{unreached:10}{share:10.1%}")
    path = tree.state / "missed.txt"
    path.write_text("\n".join(
        f"{one['name']}\n  {one['reached_by']} tests of its package reach it\n{one['diff']}\n" for one in missed))
    print("missed mutants with diffs:", path)


def command_compare(arguments):
    trees = [Tree(arguments.work, commit) for commit in (arguments.before, arguments.after)]
    before, after = [read_results(tree) for tree in trees]
    for tree, results in zip(trees, (before, after)):
        if not results:
            sys.exit(f"no results of {tree.commit[:12]}: mutants.py run {tree.commit[:12]}")
    gone = {one["key"]: one for one in load(trees[1].state / "gone.json", [])}
    lost, gained, vanished, not_run = [], [], [], []
    for key, one in before.items():
        caught = one["result"] != "missed"
        if key in after:
            caught_after = after[key]["result"] != "missed"
            if caught != caught_after:
                (lost if caught else gained).append(key)
        else:
            (vanished if key in gone else not_run).append(key)
    for key in vanished:
        print(f"gone: {gone[key]['name']}: {gone[key]['why']} (before: {before[key]['result']})")
    for key in lost:
        one = after[key]
        print(f"LOST: {one['name']}\n  before caught by: {before[key]['test']}\n"
              f"  after: {one['reached_by']} tests of its package reach it ({one['found']})\n{one['diff']}")
    counts = f"{len(lost)} lost, {len(gained)} gained, {len(vanished)} gone, {len(not_run)} not run"
    print(f"{len(before)} mutants: {counts}")
    sys.exit(1 if lost or not_run else 0)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    default = os.environ.get("POSEBRIDGE_MUTANTS") or REPOSITORY / "target/mutants"
    parser.add_argument("--work", type=lambda path: Path(path).resolve(), default=Path(default).resolve(),
                        help="folder for clones, builds and results (default: $POSEBRIDGE_MUTANTS or target/mutants)")
    commands = parser.add_subparsers(dest="command", required=True)
    sample = commands.add_parser("sample", help="draw a sample of the mutants of a commit, without a build")
    sample.set_defaults(act=command_sample)
    sample.add_argument("-n", "--number", type=int, default=150, help="mutants of each package")
    run = commands.add_parser("run", help="build a commit with the sample's mutants and try each; resumable")
    run.set_defaults(act=command_run)
    run.add_argument("-j", "--jobs", type=int, default=1, help="tests at a time")
    for command in (sample, run):
        command.add_argument("commit")
        command.add_argument("-p", "--package", action="append", help="only this package; may be repeated")
    compare = commands.add_parser("compare", help="list mutants caught in one commit and missed in another")
    compare.set_defaults(act=command_compare)
    compare.add_argument("before")
    compare.add_argument("after")
    arguments = parser.parse_args()
    arguments.act(arguments)


if __name__ == "__main__":
    main()
