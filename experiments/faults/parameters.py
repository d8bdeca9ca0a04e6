"""Every method with random parameters within their documented bounds, on clouds of 300 points: labels or a clear error.

    python experiments/faults/parameters.py [--sets 1000] [--seed 0] [--methods smrf,csf] [--only 17] [--out DIR]

About half of the fields of a set are drawn: choices at random, numbers at an end of their range, or up to 10,000 times larger
or smaller than the default. Processor seconds are those of the call, compilations included, in a process that has called the
method before; memory is the peak of that process in the call (Linux only). A process tries several sets; one that misses is
tried again in a process of its own, which counts. Ends with 1 if a set crashed, gave an unclear error, or missed a bound.
"""

from __future__ import annotations

import argparse
import csv
import json
import selectors
import shlex
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from experiments import report

SECONDS, MEGABYTES = 10.0, 1024.0
"""What a set may take: processor time of the call, peak memory of the process."""
POINTS = 300
_PATIENCE = 240.0  # seconds on the clock, then the process is killed
_TOGETHER = 20  # sets of one process
COLUMNS = (
    ("method", "method", ""),
    ("sets", "sets", ",.0f"),
    ("labels", "labels", ",.0f"),
    ("refused", "clear errors", ",.0f"),
    ("missed", "missed", ",.0f"),
    ("seconds", "most CPU s", ".1f"),
    ("megabytes", "most MB", ".0f"),
)


def cloud(rng: np.random.Generator) -> np.ndarray:
    """f64[300, 3]: a slope with houses and a few low points, 10 m to 3 km wide, in centimetres."""
    size = 10 ** rng.uniform(1, 3.5)
    xy = rng.uniform(0, size, (POINTS, 2)) * [1.0, 10 ** rng.uniform(-1, 0)]
    z = rng.normal(0, 0.05, POINTS) + rng.uniform(0, 0.5) * xy[:, 0] + 8.0 * (np.sin(6 * xy / size).prod(axis=1) > 0.5)
    z[rng.random(POINTS) < 0.01] -= 20.0
    return np.column_stack([xy + rng.uniform(-1e6, 1e6, 2), z + rng.uniform(0, 3000)]).round(2)


def value(field: Any, rng: np.random.Generator) -> Any:
    """A value that the declaration of a field allows, as far as it tells for the field alone."""
    meta, default = field.metadata, field.default
    if meta.get("choices") is not None:
        return meta["choices"][rng.integers(len(meta["choices"]))]
    if meta.get("optional") and rng.random() < 0.3:
        return None
    limits = meta["limits"]
    low = next((bound for sign, bound in limits.items() if ">" in sign), -1e9)
    high = next((bound for sign, bound in limits.items() if "<" in sign), 1e9)
    scale = default if isinstance(default, int | float) and 0 < default < 1e9 else 1.0
    kind = rng.integers(5)
    drawn = [low, high][kind] if kind < 2 else scale * 10 ** rng.uniform(-4, 4)
    if kind == 0 and ">" in limits:
        drawn = low + 1e-6
    if kind == 1 and "<" in limits:
        drawn = high - 1e-6
    drawn = min(max(drawn, low), high)
    if field.type in ("int", int):
        return int(min(max(round(drawn), low), high))
    if kind == 2 and meta.get("endless"):
        return float("inf")
    return float(drawn)


def drawn(method: str, number: int, seed: int) -> tuple[dict[str, Any], np.ndarray]:
    """The fields of a set, and its cloud."""
    import jaxfilter as jf
    from jaxfilter.core.params import declared

    rng = np.random.default_rng([seed, number])
    fields = {f.name: value(f, rng) for f in declared(jf.FILTERS[method]) if rng.random() < 0.5}
    return fields, cloud(rng)


def peak() -> int:
    """Largest memory of this process since it was last asked to count anew, MB."""
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) // 1024


def tried(method: str, number: int, seed: int) -> dict[str, Any]:
    """One set, in this process."""
    import jaxfilter as jf

    fields, xyz = drawn(method, number, seed)
    Path("/proc/self/clear_refs").write_text("5")  # the peak is counted anew
    start = time.process_time()
    try:
        result = jf.FILTERS[method](**fields)(xyz, workers=2)
        assert len(result) == len(xyz)
        outcome = f"{int(result.ground.sum()):,} ground"
    except (jf.ParameterError, jf.InputError) as error:
        outcome = f"{type(error).__name__}: {error}"
    except Exception as error:
        return {"outcome": f"crash: {type(error).__name__}: {error}"}
    return {
        "seconds": round(time.process_time() - start, 2),
        "megabytes": peak(),
        "outcome": outcome,
    }


def serve(seed: int) -> None:
    """Try what standard input names, line by line; begin with the defaults of each method, which compiles them."""
    import jaxfilter as jf

    warnings.simplefilter("ignore")
    known = set()
    for line in sys.stdin:
        method, number = line.split()
        if method not in known:
            known.add(method)
            jf.FILTERS[method]()(cloud(np.random.default_rng(0)))
        print(json.dumps(tried(method, int(number), seed)), flush=True)


def ask(process: subprocess.Popen[str], method: str, number: int, first: bool) -> dict[str, Any]:
    """What a set does in the process that serves. Ends the process if it takes too long."""
    assert process.stdin is not None and process.stdout is not None
    process.stdin.write(f"{method} {number}\n")
    process.stdin.flush()
    with selectors.DefaultSelector() as waiting:
        waiting.register(process.stdout, selectors.EVENT_READ)
        patience = (3 if first else 1) * _PATIENCE
        if not waiting.select(patience):
            process.kill()
            process.wait()
            return {"outcome": f"killed after {patience:g} s"}
        line = process.stdout.readline()
    if not line:
        return {"outcome": f"crash: exit code {process.wait()}"}
    return dict(json.loads(line))


def missed(row: dict[str, Any]) -> bool:
    """Whether a set crashed or took too much."""
    return "seconds" not in row or row["seconds"] > SECONDS or row["megabytes"] > MEGABYTES


def typed(row: dict[str, str]) -> dict[str, Any]:
    """A row of the table as it was before it was written."""
    numbers = {key: float(row[key]) for key in ("seconds", "megabytes") if row[key]}
    return {
        "set": int(row["set"]),
        "method": row["method"],
        **numbers,
        "outcome": row["outcome"],
        "fields": row["fields"],
    }


def write(rows: list[dict[str, Any]], out: Path) -> None:
    """The tables of what was tried so far."""
    rows = sorted(rows, key=lambda row: row["set"])
    out.mkdir(parents=True, exist_ok=True)
    report.write_csv(out / "parameters.csv", rows)
    table = []
    for method in sorted({row["method"] for row in rows}):
        own = [row for row in rows if row["method"] == method]
        done = [row["outcome"] for row in own if "seconds" in row]
        table.append(
            {
                "method": method,
                "sets": len(own),
                "labels": sum(text.endswith(" ground") for text in done),
                "refused": sum("Error: " in text for text in done),
                "missed": sum(map(missed, own)),
                "seconds": max((row.get("seconds", np.inf) for row in own), default=0.0),
                "megabytes": max((row.get("megabytes", np.inf) for row in own), default=0.0),
            }
        )
    bad = [row for row in rows if missed(row)]
    lines = [
        "# Random parameters",
        "",
        f"Bounds: labels or a clear error within {SECONDS:g} s of processor time and {MEGABYTES:g} MB, {POINTS} points each.",
        f"{len(bad)} of {len(rows)} sets missed them.",
        "",
        report.markdown(COLUMNS, table),
        "",
        *(f"- set {row['set']}, {row['method']}, {row['outcome']}: `{row['fields']}`" for row in bad),
    ]
    command = shlex.join(["python", "experiments/faults/parameters.py", *sys.argv[1:]])
    report.write_page(out / "parameters.md", "\n".join(lines), command)


def main() -> int:
    """Try all sets and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    parser.add_argument("--sets", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--methods", help="these only; what the tables hold of others stays")
    parser.add_argument("--only", help="numbers of sets, separated by commas")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.serve:
        serve(arguments.seed)
        return 0

    import jaxfilter as jf

    every = sorted(jf.FILTERS)
    methods = arguments.methods.split(",") if arguments.methods else every
    named = {int(number) for number in arguments.only.split(",")} if arguments.only else None
    rows: list[dict[str, Any]] = []
    if arguments.methods and (known := arguments.out / "parameters.csv").exists():  # which others were tried before
        with open(known, newline="") as file:
            rows = [typed(row) for row in csv.DictReader(file) if row["method"] not in methods]
    for method in methods:
        numbers = [n for n in range(every.index(method), arguments.sets, len(every)) if named is None or n in named]
        process, left = None, 0
        for number in numbers:
            fields, _ = drawn(method, number, arguments.seed)
            for alone in (False, True):
                if process is None or process.poll() is not None or left == 0 or alone:
                    if process is not None:
                        process.kill()
                    command = [sys.executable, __file__, "--serve", "--seed", str(arguments.seed)]
                    process = subprocess.Popen(command, stdin=-1, stdout=-1, stderr=subprocess.DEVNULL, text=True)
                    left = _TOGETHER
                row = {"set": number, "method": method, **ask(process, method, number, left == _TOGETHER)}
                left -= 1
                if not missed(row) or left == _TOGETHER - 1:
                    break
            rows.append(row | {"fields": json.dumps(fields)})
            if missed(row) or named:
                print(rows[-1], flush=True)
        if process is not None:
            process.kill()
        bad = sum(missed(row) for row in rows if row["method"] == method)
        print(f"{method}: {len(numbers)} sets, {bad} missed", flush=True)
        write(rows, arguments.out)
    return 1 if any(map(missed, rows)) else 0


if __name__ == "__main__":
    sys.exit(main())
