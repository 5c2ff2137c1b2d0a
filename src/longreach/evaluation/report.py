"""One page that says it all: a self-contained HTML file, without scripts and without anything fetched."""

import base64
from collections.abc import Mapping, Sequence
from html import escape

from longreach.evaluation.tables import Table

CAPTIONS = {
    "paths": "The paths in the plane, all from the same start.",
    "squared_errors": "Mean squared error from the start to each instant; the squared errors themselves stand pale "
    "behind. Lower is better.",
    "error_bounds": "Error of the fused pose in the robot's own frame, and the ±3σ band that the filter stated for it. "
    "An honest filter stays inside nearly always, and fills the band.",
    "scan_map": "Every laser return, laid along the estimated path. Walls drawn twice are drift.",
    "relations": "How many of the verified relative poses have an error below each value. Further left is better; the "
    "dotted line marks the median.",
    "innovation": "How surprised the filter was by each source. The running mean stays in the band when the "
    "covariances are of the right size; above it they are too small, below it too large.",
}

_STYLE = """
:root { color-scheme: light dark; --ink: #1c1e21; --paper: #fff; --quiet: #5b6169; --line: #d9dce0; --band: #f5f6f8; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e6e9; --paper: #16181b; --quiet: #a0a6ae; --line: #363b42; --band: #1f2226; }
}
body { margin: 0 auto; padding: 2rem 1.25rem 4rem; max-width: 52rem; background: var(--paper); color: var(--ink);
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .6rem; overflow-wrap: anywhere; }
h2 { font-size: 1.2rem; margin: 2.4rem 0 .6rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .92rem; font-variant-numeric: tabular-nums; }
th, td { padding: .35rem .7rem; text-align: right; white-space: nowrap; }
th:nth-child(-n+2), td:nth-child(-n+2) { text-align: left; }
td:nth-child(2) { color: var(--quiet); }
thead th { border-bottom: 2px solid var(--line); }
tbody tr:nth-child(even) { background: var(--band); }
figure { margin: 1.6rem 0; }
figure img { display: block; width: 100%; height: auto; background: #fff; border: 1px solid var(--line);
  border-radius: 6px; }
figcaption { margin-top: .5rem; color: var(--quiet); font-size: .92rem; }
.failed { border-left: 4px solid #d55e00; padding-left: .7rem; font-weight: 600; }
li { margin: .25rem 0; }
details { margin: 1rem 0; }
summary { cursor: pointer; }
@media (max-width: 36rem) {
  th, td { padding: .3rem .3rem; font-size: .8rem; }
  th:first-child, td:first-child { white-space: normal; }
}
pre { background: var(--band); border: 1px solid var(--line); border-radius: 6px; padding: 1rem; overflow-x: auto;
  font: .85rem/1.45 ui-monospace, SFMono-Regular, Menlo, Consolas, monospace; }
"""


def _table(table: Table) -> str:
    head = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in table.header)
    rows = "\n".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in table.rows)
    return f'<div class="scroll"><table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{rows}\n</tbody></table></div>'


def _figure(png: bytes, caption: str) -> str:
    data = base64.b64encode(png).decode("ascii")
    text = escape(caption)
    return f'<figure><img alt="{text}" src="data:image/png;base64,{data}"><figcaption>{text}</figcaption></figure>'


def _section(heading: str, body: str) -> str:
    return f"<section><h2>{heading}</h2>\n{body}\n</section>\n" if body else ""


def report_html(
    title: str,
    introduction: str,
    table: Table,
    figures: Mapping[str, bytes],
    captions: Mapping[str, str] = CAPTIONS,
    remarks: Sequence[str] = (),
    config_yaml: str = "",
    more: Table | None = None,
    failures: Sequence[str] = (),
) -> str:
    """Return the page.

    Arguments:
        introduction: what it is: a sentence or a few; empty lines part paragraphs.
        figures: name → PNG, in the order in which they are shown. captions: by the same names.
        remarks: what was repaired or left out, a sentence each.
        config_yaml: the configuration that ran. more: the table of all metrics, folded away.
        failures: which runs did not reach their end and why, a sentence each; they come first.
    """
    failed = "\n".join(f'<p class="failed">{escape(failure)}</p>' for failure in failures)
    paragraphs = "\n".join(f"<p>{escape(p.strip())}</p>" for p in introduction.split("\n\n") if p.strip())
    shown = "\n".join(_figure(png, captions.get(name, name)) for name, png in figures.items())
    listed = "\n".join(f"<li>{escape(remark)}</li>" for remark in remarks)
    results = _table(table) if table.rows else "<p>There was no reference to compare with.</p>"
    if more is not None and more.rows:
        results += f"\n<details><summary>All metrics</summary>\n{_table(more)}</details>"
    config = f"<details><summary>All keys and values</summary>\n<pre>{escape(config_yaml)}</pre></details>"
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        f"<header>{failed}<h1>{escape(title)}</h1>\n{paragraphs}</header>\n"
        + _section("Results", results)
        + _section("Figures", shown)
        + _section("Remarks", f"<ul>\n{listed}\n</ul>" if remarks else "")
        + _section("Configuration that ran", config if config_yaml else "")
        + "</body>\n</html>\n"
    )
