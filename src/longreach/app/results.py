"""What every run leaves behind, whatever it did: metrics.json, figures and one page."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from longreach.evaluation import style
from longreach.evaluation.report import CAPTIONS, report_html
from longreach.evaluation.tables import Metric, failures, main_metrics, metric_table

Progress = Callable[[str, float], None]


def write_results(
    folder: Path,
    title: str,
    introduction: str,
    metrics: Mapping[str, Mapping[str, Metric]],
    drawn: Mapping[str, Callable[[], Figure]],
    config: str,
    tell: Progress,
    remarks: Sequence[str] = (),
    captions: Mapping[str, str] = CAPTIONS,
    main: Mapping[str, Mapping[str, Metric]] | None = None,
) -> None:
    """Write into a folder that is there; figures are drawn one by one, so that only one is in memory.

    main: what the page's first table shows of the metrics; None: the few that tell most of a trajectory.
    """
    text = json.dumps(metrics, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    (folder / "metrics.json").write_text(text, encoding="utf-8")
    (folder / "config.yaml").write_text(config, encoding="utf-8")
    (folder / "figures").mkdir()
    pictures = {}
    for i, (name, draw) in enumerate(drawn.items()):
        tell("figures", i / len(drawn))
        pictures[name] = style.png(draw())
        (folder / "figures" / f"{name}.png").write_bytes(pictures[name])
    main = main_metrics(metrics) if main is None else main
    page = report_html(
        title,
        introduction,
        metric_table(main if any(main.values()) else metrics),
        pictures,
        captions,
        remarks,
        config,
        more=metric_table(metrics) if any(main.values()) else None,
        failures=failures(metrics),
    )
    (folder / "report.html").write_text(page, encoding="utf-8")
