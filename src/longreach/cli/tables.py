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


def print_metrics(metrics: Mapping[str, Mapping[str, Any]]) -> None:
    """Print the main metrics, a column a trajectory; the report holds the rest."""
    from longreach.evaluation.tables import main_metrics, metric_table

    table = metric_table(main_metrics(metrics))
    print_table(table.header, table.rows)
