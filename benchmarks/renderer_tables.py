"""The report of `renderer.py` as Markdown."""

AIMS = {64: 1000, 112: 1000, 224: 4000}  # times the speed of PyTorch3D's documented soft silhouette
OURS, SOFT = "fold scan, S=4", "PyTorch3D, K=50"
MIB = 2**20


def markdown(report: dict) -> str:
    parts = (header, beside, accuracy, sweeps, grid, steps)
    return "\n\n".join(part(report) for part in parts) + "\n"


def header(report: dict) -> str:
    versions = ", ".join(f"{name} {number}" for name, number in report["versions"].items())
    return (
        "# The renderer, measured\n\n"
        f"`{report['command']}`, commit {report['commit']}, {report['minutes']:.1f} minutes. {report['hardware']}; "
        f"{report['threads']} threads unless stated; {versions}.\n\n"
        "Median wall time in ms a frame, of the repeats that are stated, from world vertices to the picture (forward) "
        "or to the gradient of a sum of squared differences (both). How: `benchmarks/renderer.py`."
    )


def table(head: list[str], rows: list[list[str]]) -> str:
    return "\n".join("| " + " | ".join(row) + " |" for row in [head, ["---"] * len(head), *rows])


def beside(report: dict) -> str:
    """Times of all renderers, and how many times as fast ours is."""
    found = [row for row in report["compared"] if "missing" not in row]
    ours = {row["side"]: row["both"]["ms"] for row in found if row["renderer"] == OURS}
    rows = []
    for row in report["compared"]:
        if "missing" in row:
            rows.append([row["renderer"], f"{row['missing']}", *[""] * 5])
            continue
        ratio = row["both"]["ms"] / ours[row["side"]]
        aim = f" (aim {AIMS[row['side']]:,})" if row["renderer"] == SOFT and row["side"] in AIMS else ""
        rows.append(
            [
                row["renderer"],
                f"{row['side']}",
                f"{row['frames']}",
                f"{row['forward']['ms']:.3g}",
                f"{row['both']['ms']:.3g}",
                f"{row['both']['repeats']}",
                f"{ratio:,.3g}{aim}" if ratio < 100 else f"{ratio:,.0f}{aim}",
            ]
        )
    head = ["renderer", "px", "frames a call", "forward", "both", "repeats", f"times {OURS}"]
    return "## Beside others: time\n\n6,890 vertices, 13,776 faces, one channel.\n\n" + table(head, rows)


def accuracy(report: dict) -> str:
    found = [row for row in report["compared"] if "gradient" in row]
    kinds = list(found[0]["gradient"])
    rows = [
        [row["renderer"], f"{row['side']}", f"{row['mean error']:.1e}", f"{row['IoU']:.4f}", f"{row['soft IoU']:.4f}"]
        + [f"{row['gradient'][kind]['error']:.2g}" for kind in kinds]
        + [f"{min(row['gradient'][kind]['sign'] for kind in kinds):.2f}"]
        for row in found
    ]
    head = ["renderer", "px", "mean error", "IoU", "soft IoU", *kinds, "least sign agreement"]
    return (
        "## Beside others: error\n\n"
        f"Over {report['plan']['poses']} poses, against exact area coverage. IoU is of the masks above 1/2, soft IoU "
        "the sum of minima over that of maxima. The motions' columns are relative L2 errors of the derivatives of the "
        "loss against another pose's exact picture; signs are counted where the derivative is over 2 % of the "
        "largest.\n\n" + table(head, rows)
    )


def sweeps(report: dict) -> str:
    """The cost along each variable, and its exponents."""
    base = ", ".join(f"{name} {value}" for name, value in report["base"].items())
    sections = [f"## Cost about a base point\n\n{base}. Peak: all tensors of one call, forward and gradient."]
    exponents = []
    for name, found in report["sweeps"].items():
        rows = [
            [f"{row['faces']:,}" if name == "body" else f"{row[name]}", *figures(row), f"{row['both']['repeats']}"]
            for row in found["rows"]
        ]
        head = ["faces" if name == "body" else name, "forward", "both", "peak MiB a call", "KiB a frame", "repeats"]
        sections.append(table(head, rows))
        for cost, slopes in found.get("exponents", {}).items():
            exponents.append([name, cost, f"{slopes['all']:.2f}", f"{slopes['largest two']:.2f}"])
    sections.append(
        "Exponents of a whole call's cost (1 is linear): the slope of the logarithms over all rows, and between the "
        "last two.\n\n" + table(["variable", "cost", "all", "last two"], exponents)
    )
    return "\n\n".join(sections)


def figures(row: dict) -> list[str]:
    peak = row["both"]["peak"]
    times = [f"{row[way]['ms']:.3g}" for way in ("forward", "both")]
    return [*times, f"{peak / MIB:.3g}", f"{peak / 1024 / row['batch']:.3g}"]


def grid(report: dict) -> str:
    rows = [[f"{row['side']}", f"{row['faces']:,}", *figures(row)] for row in report["grid"]]
    head = ["px", "faces", "forward", "both", "peak MiB a call", "KiB a frame"]
    return f"## Size by mesh, batch {report['base']['batch']}\n\n" + table(head, rows)


def steps(report: dict) -> str:
    """The renderer's share of a decoupling step."""
    steps = report["steps"]
    stages = sorted(next(iter(steps.values())), key=lambda stage: -max(step[stage]["share"] for step in steps.values()))
    rows = [
        [stage, *(f"{ms(step[stage]):.3g} ({100 * step[stage]['share']:.0f} %)" for step in steps.values())]
        for stage in stages
    ]
    totals = ["**sum**", *(f"{sum(map(ms, step.values())):.0f}" for step in steps.values())]
    return (
        "## A decoupling step\n\nMedian ms, forward and backward together, by stage; six parts, 64 px, the shipped "
        "MAE. What is drawn: `benchmarks/stages.py`.\n\n" + table(["stage", *steps], [*rows, totals])
    )


def ms(stage: dict) -> float:
    return stage["forward"] + stage["backward"]
