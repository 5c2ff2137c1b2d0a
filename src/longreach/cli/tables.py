"""Tables on the terminal."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any


def print_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print rows of text under a header; all columns but the first two are set to the right."""
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, header_style="bold", pad_edge=False)
    for i, name in enumerate(header):
        table.add_column(name, justify="left" if i < 2 else "right", no_wrap=i == 0)
    for row in rows:
        table.add_row(*row)
    console = Console()
    # never fold a table because the output is a file
    console = console if console.is_terminal else Console(width=160)
    console.print(table)


# What a newcomer wants to see first, best known reference first; the report holds the rest.
_FIRST = (
    "ate_rmse",
    "heading_rms",
    "final_position_error",
    "final_heading_error",
    "relations_5s_translation_mean",
    "relations_5s_rotation_mean",
    "nees_mean",
    "path_length",
)


def print_metrics(metrics: Mapping[str, Mapping[str, Any]]) -> None:
    """Print the main metrics, a column a trajectory."""
    from longreach.evaluation.tables import metric_table

    names = [name for name in _FIRST if any(name in named for named in metrics.values())]
    table = metric_table(
        {who: {name: named[name] for name in names if name in named} for who, named in metrics.items()}
    )
    print_table(table.header, table.rows)
