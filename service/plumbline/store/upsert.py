"""INSERT … ON CONFLICT. The update is plain SQL on positional parameters: one form for both databases, and fast.

SQLAlchemy's own executemany converts every row from a dictionary; a batch of tens of thousands of rows a second goes to
the driver as tuples instead.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any

from sqlalchemy import Connection, Table
from sqlalchemy.dialects import postgresql, sqlite


def upsert(
    connection: Connection,
    table: Table,
    rows: Sequence[tuple[Any, ...]],
    *,
    newer_by: str | None = None,
    not_older_by: str | None = None,
) -> None:
    """Insert rows (values in the order of the table's columns) or replace those of the same key.

    With ``newer_by`` a row is replaced only by one whose ``newer_by`` column is greater, with ``not_older_by`` by one
    whose column is not less.
    """
    condition = ""
    for column, comparison in ((newer_by, ">"), (not_older_by, ">=")):
        if column is not None:
            condition = f' WHERE excluded."{column}" {comparison} {table.name}."{column}"'
    if rows:
        connection.exec_driver_sql(_statement(table, connection.dialect.paramstyle, condition), list(rows))


def insert_new(connection: Connection, table: Table, row: dict[str, Any]) -> bool:
    """Insert a row unless its key is taken; returns whether it was inserted."""
    dialect = postgresql if connection.dialect.name == "postgresql" else sqlite
    statement = dialect.insert(table).values(row).on_conflict_do_nothing().returning(*table.primary_key)
    return connection.execute(statement).first() is not None


@cache
def _statement(table: Table, paramstyle: str, condition: str) -> str:
    names = [f'"{column.name}"' for column in table.columns]
    keys = [f'"{column.name}"' for column in table.primary_key]
    changes = ", ".join(f"{name} = excluded.{name}" for name in names if name not in keys)
    marks = ", ".join(["?" if paramstyle == "qmark" else "%s"] * len(names))
    return (
        f"INSERT INTO {table.name} ({', '.join(names)}) VALUES ({marks}) "
        f"ON CONFLICT ({', '.join(keys)}) DO UPDATE SET {changes}{condition}"
    )
