"""Alembic's entry: run the migrations on the connection that :func:`plumbline.store.engine.upgrade` hands over."""

from alembic import context

from plumbline.store.tables import metadata

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=metadata,
    transactional_ddl=True,  # SQLite too: the engine begins its transactions itself
)
context.run_migrations()
