"""`/metrics` of a running station by what `promtool check metrics` checks.

promtool itself comes with Prometheus and is in no registry that these tests install from. So the official Python client parses the page, and the
rules are those of promtool's linter (client_golang, prometheus/testutil/promlint: its ten validations), written down here once more. What its
parser checks beyond the Python one, the order and the number of HELP and TYPE lines, is checked on the lines.
"""

import collections
import re
import tempfile
import unittest
import urllib.request

from prometheus_client.parser import text_string_to_metric_families

from drives import for_ground_stations, simulated
from ground import Ground
from harness import DEADLINE_S, RunningStation

TYPES = ("counter", "gauge", "histogram", "summary", "untyped")
# What stands in a name for a type; promlint leaves out `untyped`.
TYPE_WORDS = ("counter", "gauge", "summary", "histogram", "gauge_histogram")
BASE_UNITS = ("amperes", "bytes", "celsius", "grams", "joules", "kelvin", "meters", "metres", "seconds", "volts")
OTHER_UNITS = (
    "minutes", "hours", "days", "weeks", "kelvins", "fahrenheit", "rankine", "inches", "yards", "miles", "bits", "calories", "pounds", "ounces")
PREFIXES = (
    "pico", "nano", "micro", "milli", "centi", "deci", "deca", "hecto", "kilo", "kibi", "mega", "mibi", "giga", "gibi", "tera", "tebi", "peta", "pebi")
ABBREVIATIONS = ("s", "ms", "us", "ns", "sec", "b", "kb", "mb", "gb", "tb", "pb", "m", "h", "d")
CAMEL_CASE = re.compile("[a-z][A-Z]")
# Of a histogram and of a summary, the endings of what it prints.
ENDINGS = {"histogram": ("_bucket", "_sum", "_count"), "summary": ("", "_sum", "_count")}


class Family:
    """What a page says about one metric; samples are (name, labels)."""

    def __init__(self, name):
        self.name, self.help, self.type, self.samples = name, None, "untyped", []


def families_of(page):
    """The metrics of a page by their names, and what is wrong with the order of its lines."""
    families, problems, last = {}, [], None
    # The names of counters as they stand there: the parser takes `_total` away, and adds it where it is missing.
    for line in page.splitlines():
        comment = re.fullmatch(r"# (HELP|TYPE) (\S+) (.*)", line)
        name = comment[2] if comment else re.match(r"[^{\s]*", line)[0]
        if not comment:
            owner = owner_of(name, families)
            if owner is None:
                problems.append(f"{name}: no TYPE before it")
                owner = families.setdefault(name, Family(name))
            elif owner is not last and owner.samples:
                problems.append(f"{name}: its samples are not in one group")
            owner.samples.append(name)
            last = owner
            continue
        family = families.setdefault(name, Family(name))
        if family.samples:
            problems.append(f"{name}: {comment[1]} after its samples")
        if comment[1] == "HELP":
            if family.help is not None:
                problems.append(f"{name}: a second HELP")
            family.help = comment[3]
        else:
            if family.type != "untyped" or comment[3] not in TYPES:
                problems.append(f"{name}: TYPE {comment[3]}")
            family.type = comment[3]
    for family in families.values():
        family.samples = []
    for parsed in text_string_to_metric_families(page):
        for sample in parsed.samples:
            owner = owner_of(sample.name, families) or families[sample.name.removesuffix("_total")]
            owner.samples.append((sample.name, tuple(sorted(sample.labels.items()))))
    return families, problems


def owner_of(name, families):
    """The metric that a sample of that name belongs to."""
    if name in families:
        return families[name]
    for kind, endings in ENDINGS.items():
        for ending in endings:
            family = families.get(name.removesuffix(ending))
            if name.endswith(ending) and family is not None and family.type == kind:
                return family
    return None


def has_word(name, word):
    """Whether it stands in the name or at its end, but not at its beginning."""
    return f"_{word}_" in name or name.endswith(f"_{word}")


def base_unit_problem(name):
    """The first unit in a name must be a base unit without a prefix."""
    for word in name.split("_"):
        if word in BASE_UNITS:
            return None
        if any(word == prefix + unit for prefix in ("", *PREFIXES) for unit in BASE_UNITS + OTHER_UNITS):
            return f"no base unit: {word}"
    return None


def lint(page):
    """What promtool would complain of."""
    families, problems = families_of(page)
    for family in families.values():
        problems += [f"{family.name}: {problem}" for problem in problems_of(family)]
    return problems


def problems_of(family):
    name, kind = family.name, family.type
    labels = {label for _, pairs in family.samples for label, _ in pairs}
    lower = name.lower()
    if family.help is None:
        yield "no help"
    if problem := base_unit_problem(name):
        yield problem
    if kind == "counter" and not name.endswith("_total"):
        yield "a counter without _total"
    if kind not in ("counter", "untyped") and name.endswith("_total"):
        yield "_total, but no counter"
    if kind not in ("gauge", "untyped") and name.endswith("_timestamp_seconds"):
        yield "_timestamp_seconds, but no gauge"
    if kind != "untyped":
        owners = {"_bucket": ("histogram",), "_count": ("histogram", "summary"), "_sum": ("histogram", "summary")}
        yield from (f"{ending} is reserved" for ending, of in owners.items() if name.endswith(ending) and kind not in of)
        reserved = {"le": "histogram", "quantile": "summary"}
        yield from (f"label {label} is reserved" for label, of in reserved.items() if label in labels and kind != of)
    yield from (f"a type in its name: {word}" for word in TYPE_WORDS if has_word(lower, word))
    if ":" in name:
        yield "a colon"
    yield from (f"camelCase: {word}" for word in (name, *sorted(labels)) if CAMEL_CASE.search(word))
    yield from (f"an abbreviated unit: {word}" for word in ABBREVIATIONS if has_word(lower, word))
    yield from (f"{sample} twice" for sample, times in collections.Counter(family.samples).items() if times > 1)


class Metrics(unittest.TestCase):
    def test_promtool_would_complain_of_nothing(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        config = simulated(folder.name) + for_ground_stations("udp")
        station = RunningStation(folder.name, "run", config, "--dashboard", "127.0.0.1:0").belongs_to(self)
        address = station.wait_for("dashboard: http://").split()[-1]
        ground = Ground(station.addresses[0])
        self.addCleanup(ground.close)
        # The health of links is said once a second, and the robot's clock is asked at once.
        ground.hear_beats(3)
        with urllib.request.urlopen(f"{address}metrics", timeout=DEADLINE_S) as answer:
            self.assertEqual(answer.headers["Content-Type"], "text/plain; version=0.0.4; charset=utf-8")
            page = answer.read().decode("utf-8")
        self.assertTrue(page.endswith("\n"))
        self.assertEqual(lint(page), [])
        families, _ = families_of(page)
        self.assertGreater(len(families), 30)
        # A label that is only printed with a sample is only checked with one.
        self.assertEqual([name for name, family in families.items() if not family.samples], [])

    def test_each_rule_finds_what_it_is_for(self):
        for page, problem in (
            ("# TYPE a gauge\na 1\n", "a: no help"),
            ("# HELP a_milliseconds h\n# TYPE a_milliseconds gauge\na_milliseconds 1\n", "a_milliseconds: no base unit: milliseconds"),
            ("# HELP a_hours h\n# TYPE a_hours gauge\na_hours 1\n", "a_hours: no base unit: hours"),
            ("# HELP a h\n# TYPE a counter\na 1\n", "a: a counter without _total"),
            ("# HELP a_total h\n# TYPE a_total gauge\na_total 1\n", "a_total: _total, but no counter"),
            ("# HELP a_timestamp_seconds h\n# TYPE a_timestamp_seconds histogram\n", "a_timestamp_seconds: _timestamp_seconds, but no gauge"),
            ("# HELP a_count h\n# TYPE a_count gauge\na_count 1\n", "a_count: _count is reserved"),
            ('# HELP a h\n# TYPE a gauge\na{le="1"} 1\n', "a: label le is reserved"),
            ("# HELP a_counter_b1 h\n# TYPE a_counter_b1 gauge\na_counter_b1 1\n", "a_counter_b1: a type in its name: counter"),
            ("# HELP a:b h\n# TYPE a:b gauge\na:b 1\n", "a:b: a colon"),
            ('# HELP a h\n# TYPE a gauge\na{bC="1"} 1\n', "a: camelCase: bC"),
            ("# HELP a_ms h\n# TYPE a_ms gauge\na_ms 1\n", "a_ms: an abbreviated unit: ms"),
            ('# HELP a h\n# TYPE a gauge\na{b="1"} 1\na{b="1"} 2\n', "a: ('a', (('b', '1'),)) twice"),
            ("# HELP a h\na 1\n# TYPE a gauge\n", "a: TYPE after its samples"),
            ("# HELP a h\n# HELP a h\n# TYPE a gauge\na 1\n", "a: a second HELP"),
            ("# HELP a h\n# TYPE a gauge\n# HELP b h\n# TYPE b gauge\na 1\nb 1\na{c=\"1\"} 1\n", "a: its samples are not in one group"),
        ):
            self.assertEqual(lint(page), [problem], page)


if __name__ == "__main__":
    unittest.main()
