"""A trajectory's table with rows in between, for a line that is smooth where the table's rows are far apart."""

from tests.validation.tables import Table, even_interval


def finer(table: Table, parts: int) -> Table:
    """Every row `parts` times with its inputs, the time (column "t") going on evenly; the last row once.

    What is not an input of the run is no longer true of its row, but for every `parts`-th one.

    Raises:
        TableError: if rows are not evenly spaced in time.
    """
    interval, column = even_interval(table["t"]), table.header.index("t")
    rows = [
        (*row[:column], f"{t + k * interval / parts:.9g}", *row[column + 1 :])
        for t, row in zip(table["t"], table.rows, strict=True)
        for k in range(parts)
    ]
    return Table(table.header, tuple(rows[: len(rows) - parts + 1]))
