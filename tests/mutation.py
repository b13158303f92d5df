"""Mutation testing of naf/ and traffic/: ``make mutation``; the result is in docs/coverage.md.

A mutant is a module with one small fault. It is killed if a test fails, and survives if all pass.
The faults are those of cosmic-ray. Its own runner starts an interpreter for every mutant, which
takes far longer than the tests; here a process that has loaded the libraries forks for each. The
kernels are interpreted. A mutant meets the quick tests that run its line: of its module, then of
all of NAF, or the recorded trajectories of the traffic. Results are kept in ``runs/mutation/``: a
run that was interrupted goes on.
"""

import argparse
import ast
import gc
import hashlib
import importlib.abc
import importlib.util
import json
import os
import random
import re
import resource
import signal
import sys
import time
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

import coverage
import pytest
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "runs" / "mutation"
LEFT_OUT = re.compile(r"__init__|_internals|/machine/")
"""Compilation and what other libraries keep private: faults there are errors or only slow."""
OPERATORS = re.compile(
    r"core/(AddNot|Replace(True|False|And|Or|Break|Continue)With\w+|NumberReplacer|ExceptionReplacer"
    r"|ZeroIterationForLoop|ReplaceUnaryOperator_Delete_\w+"
    r"|ReplaceBinaryOperator_(Add_Sub|Sub_Add|Mul_Div|Div_Mul|FloorDiv_Mul|Mod_Mul|Pow_Mul"
    r"|BitOr_BitAnd|BitAnd_BitOr)"
    r"|ReplaceComparisonOperator_(Eq_NotEq|NotEq_Eq|Is_IsNot|IsNot_Is"
    r"|Lt_(LtE|GtE)|LtE_(Lt|Gt)|Gt_(GtE|LtE)|GtE_(Gt|Lt)))"
)
"""Of cosmic-ray's, without replacements that no one would write by mistake, such as + by >>."""
MAX_TEST_SECONDS = 3
"""[s] A test that takes longer, with interpreted kernels and its lines recorded, is left out."""


@dataclass(frozen=True)
class Mutant:
    """One fault: the operator's ``occurrence``-th place in the file."""

    file: str
    source: str  # a digest
    operator: str
    occurrence: int
    line: int


def digest(*texts):
    return hashlib.blake2b("\0".join(texts).encode(), digest_size=8).hexdigest()


def read(file):
    return (ROOT / file).read_text(encoding="utf-8")


def find_modules():
    """The modules of both packages, as paths from the root."""
    paths = (
        path for name in ("naf", "traffic") for path in ROOT.glob(f"marl_lanes/{name}/**/*.py")
    )
    files = sorted(path.relative_to(ROOT).as_posix() for path in paths)
    return [file for file in files if not LEFT_OUT.search(file)]


def find_tests(file):
    """The module's own tests, and what else is quick: all of NAF's, or recorded trajectories."""
    own = Path("tests", *Path(file).parts[1:-1], f"test_{Path(file).name}")
    if own.parts[1] == "naf":
        others = sorted((ROOT / "tests/naf").glob("test_*.py"))
    else:
        others = [ROOT / "tests/traffic/test_golden.py"]
    files = [own, *(path.relative_to(ROOT) for path in others)]
    return list(dict.fromkeys(path.as_posix() for path in files))


def find_mutants(file, share):
    """A seeded sample of the mutants; a larger share contains the smaller."""
    source = read(file)
    tree = get_ast(source)
    types = set(lines_of_types(ast.parse(source)))
    found = []
    for name in filter(OPERATORS.fullmatch, operator_names()):
        operator = get_operator(name)()
        places = [
            (node.parent.type, start)
            for node in ast_nodes(tree)
            for start, _ in operator.mutation_positions(node)
        ]
        for occurrence, (parent, start) in enumerate(places):
            if parent != "parameters" and start not in types:  # a signature's lone star
                found.append(Mutant(file, digest(source), name, occurrence, start[0]))
    random.Random(file).shuffle(found)  # noqa: S311
    return found[: round(share * len(found))]


def lines_of_types(tree):
    """Where annotations have operators and numbers: (line, column)."""
    for node in ast.walk(tree):
        for kind in ("annotation", "returns"):
            if (annotation := getattr(node, kind, None)) is not None:
                for line in range(annotation.lineno, annotation.end_lineno + 1):
                    yield from ((line, column) for column in range(annotation.end_col_offset))


def statement_lines(source, line):
    """The lines of the smallest statement at a line, without the statements inside it."""
    best = range(line, line + 1)
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.stmt) and node.lineno <= line <= node.end_lineno:
            end = node.body[0].lineno if getattr(node, "body", None) else node.end_lineno + 1
            if node.lineno <= line < end:
                best = range(node.lineno, end)
    return best


def preload():
    """Load what the tests import, other than the package itself."""
    import hypothesis  # noqa: F401

    import marl_lanes.envs.batched
    import marl_lanes.envs.parallel
    import marl_lanes.training.replay  # noqa: F401

    for name in [one for one in sys.modules if one.split(".")[0] == "marl_lanes"]:
        del sys.modules[name]
    gc.freeze()


def in_child(function, cpu_seconds):
    """The exit status of a function in a process of its own; negative if it was stopped."""
    pid = os.fork()
    if pid == 0:
        # Of the processor's time, because other programs may run beside this one.
        resource.setrlimit(resource.RLIMIT_CPU, (cpu_seconds, cpu_seconds))
        signal.alarm(20 * cpu_seconds)
        null = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(null, stream)
        status = 70
        try:
            status = function()
        finally:
            os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def run_tests(*arguments, plugins=()):
    options = ("-q", "-p", "no:cacheprovider", "-m", "not (training or ray or slow or long)")
    return int(pytest.main([*options, *arguments], plugins=list(plugins)))


class Recorder:
    """Which lines each test runs, and how long it takes."""

    def __init__(self):
        self.coverage = coverage.Coverage(
            data_file=None, config_file=False, source=[str(ROOT / "marl_lanes")]
        )
        self.seconds, self.passed = {}, set()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item):
        self.coverage.switch_context(item.nodeid)
        signal.signal(signal.SIGVTALRM, lambda *_: pytest.skip("it takes too long"))
        signal.setitimer(signal.ITIMER_VIRTUAL, MAX_TEST_SECONDS)
        start = time.process_time()
        try:
            return (yield)
        finally:
            signal.setitimer(signal.ITIMER_VIRTUAL, 0)
            self.seconds[item.nodeid] = time.process_time() - start

    def pytest_runtest_logreport(self, report):
        if report.when == "call" and report.passed:
            self.passed.add(report.nodeid)

    def record(self, test_file, path):
        self.coverage.start()
        run_tests(test_file, plugins=[self])
        self.coverage.stop()
        data = self.coverage.get_data()
        found = {test: {"seconds": self.seconds[test], "lines": {}} for test in sorted(self.passed)}
        for file in sorted(data.measured_files()):
            name = Path(file).relative_to(ROOT).as_posix()
            for line, tests in data.contexts_by_lineno(file).items():
                for test in self.passed.intersection(tests):
                    found[test]["lines"].setdefault(name, []).append(line)
        path.write_text(json.dumps(found), encoding="utf-8")
        return 0


def tests_of(file):
    """Per test of the package: its seconds and the lines of the file that it runs."""
    package = file[: file.index("/", len("marl_lanes/")) + 1]
    sources = [read(module) for module in find_modules() if module.startswith(package)]
    found = {}
    for test_file in find_tests(file):
        name = digest(read(test_file), *sources)
        path = FOLDER / f"{Path(test_file).stem}-{name}.json"
        if not path.exists():
            print("measuring", test_file, flush=True)
            if in_child(lambda: Recorder().record(test_file, path), 1800) != 0:  # noqa: B023
                raise SystemExit(f"{test_file} cannot be measured")
        for test, measured in json.loads(path.read_text(encoding="utf-8")).items():
            found[test] = measured["seconds"], set(measured["lines"].get(file, ()))
    return found


def choose_tests(mutant, tests, max_seconds):
    """Those that run the mutant's statement; where it runs at import only, any of the module."""
    own = find_tests(mutant.file)[0]
    lines = set(statement_lines(read(mutant.file), mutant.line))
    chosen = [test for test in tests if tests[test][1] & lines]
    chosen = chosen or [test for test in tests if tests[test][1]]
    chosen.sort(key=lambda test: (not test.startswith(own), tests[test][0]))
    total, within = 0.0, []
    for test in chosen:
        total += tests[test][0]
        if total > max_seconds:
            break
        within.append(test)
    return within, total


class Mutated(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Loads the mutated source in place of one module's file."""

    def __init__(self, file, source):
        self.name = file.removesuffix(".py").replace("/", ".")
        self.path, self.source = str(ROOT / file), source

    def find_spec(self, name, path=None, target=None):  # noqa: ARG002
        if name == self.name:
            return importlib.util.spec_from_loader(name, self, origin=self.path)
        return None

    def exec_module(self, module):
        exec(compile(self.source, self.path, "exec"), module.__dict__)  # noqa: S102


def mutated(mutant):
    return mutate_code(read(mutant.file), get_operator(mutant.operator)(), mutant.occurrence)


def try_mutant(mutant, tests, max_seconds):
    """What became of a mutant: killed, slow, broken, or survived."""
    chosen, seconds = choose_tests(mutant, tests, max_seconds)
    if not chosen:
        return "untested"
    finder = Mutated(mutant.file, mutated(mutant))

    def run():
        sys.meta_path.insert(0, finder)
        try:
            importlib.import_module(finder.name)
        except Exception:
            return 71
        return run_tests("-x", *chosen)

    outcomes = {0: "survived", 1: "killed", 2: "killed", 5: "untested", 71: "broken"}
    status = in_child(run, int(30 + 4 * seconds))
    return "slow" if status < 0 else outcomes[status]


def is_alive(outcome):
    return outcome in ("survived", "untested")


def report(modules, results):
    print(f"{'module':45}  mutants  tried  killed  slow  broken  survived  untested")
    for file in modules:
        mutants = find_mutants(file, 1.0)
        count = Counter(results[mutant] for mutant in mutants if mutant in results)
        print(
            f"{file:45} {len(mutants):8} {count.total():6} {count['killed']:7} {count['slow']:5}"
            f" {count['broken']:7} {count['survived']:9} {count['untested']:9}"
        )
    for mutant, outcome in results.items():
        if is_alive(outcome) and mutant.file in modules:
            before, after = read(mutant.file).splitlines(), mutated(mutant).splitlines()
            changed = [pair for pair in zip(before, after, strict=True) if pair[0] != pair[1]]
            print(f"\n{mutant.file}:{mutant.line} {outcome}")
            for old, new in changed:
                print(f"  - {old.strip()}\n  + {new.strip()}")


def load_results(path, modules):
    """The latest outcome of each mutant of the modules as they are now."""
    current = {file: digest(read(file)) for file in modules}
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    results = {}
    for line in map(json.loads, lines):
        outcome = line.pop("outcome")
        if current.get(line["file"]) == line["source"]:
            results[Mutant(**line)] = outcome
    return results


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="*", help="default: all of naf/ and traffic/")
    parser.add_argument("--share", type=float, default=1.0, help="of the mutants of each module")
    parser.add_argument("--seconds", type=float, default=5.0, help="for the tests of one mutant")
    parser.add_argument("--again", action="store_true", help="try those that survived once more")
    parser.add_argument("--report", action="store_true", help="only show what is known")
    options = parser.parse_args()
    os.environ |= {
        "NUMBA_DISABLE_JIT": "1",
        "OMP_NUM_THREADS": "1",
        "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",  # to load them takes longer than most tests
    }
    modules = options.modules or find_modules()
    path = FOLDER / "results.jsonl"
    FOLDER.mkdir(parents=True, exist_ok=True)
    results = load_results(path, modules)
    if not options.report:
        preload()
        for file in modules:
            tests = tests_of(file)
            todo = [one for one in find_mutants(file, options.share) if one not in results]
            if options.again:
                todo += [one for one in results if one.file == file and is_alive(results[one])]
            for mutant in todo:
                results[mutant] = try_mutant(mutant, tests, options.seconds)
                line = json.dumps(asdict(mutant) | {"outcome": results[mutant]})
                with path.open("a", encoding="utf-8") as stream:
                    stream.write(line + "\n")
            print(file, "is done", flush=True)
    report(modules, results)


if __name__ == "__main__":
    main()
