"""Granting the roles reader, operator and owner in a PostGIS database."""

import logging

from sqlalchemy import Connection, Engine, text

from msbdb.database.dialects.connection import guarded, shown
from msbdb.database.dialects.dialect import dialect_of
from msbdb.database.dialects.rights import give, kept_rights, take
from msbdb.errors import DatabaseError, ParameterError

logger = logging.getLogger(__name__)

ROLES = ("reader", "operator", "owner", "none")
"""What can be granted; 'none' takes all rights back."""


def grant_role(engine: Engine, role: str, user: str) -> None:
    """Give a user of the server the rights of a role in a database, in place of its earlier ones.

    Parameters
    ----------
    engine : Engine
        From ``open_database``, as the owner of the database or a superuser.
    role : {'reader', 'operator', 'owner', 'none'}
        The role; ``none`` takes all rights back.
    user : str
        Name of a role of the server; all characters are allowed.

    Raises
    ------
    ParameterError
        For another role.
    DatabaseError
        When the database is a file, the user does not exist, the owner would lose its rights, or this connection may
        not grant. Nothing was changed.
    """
    if role not in ROLES:
        msg = f"A role is one of {', '.join(ROLES)}; got '{role}'."
        raise ParameterError(msg)
    if engine.dialect.name != "postgresql":
        msg = (
            f"The database {shown(engine.url)} is a file, so the rights of the file system apply. "
            "Use chmod and the like, or 'msbdb db copy' into a PostGIS database."
        )
        raise DatabaseError(msg)
    with guarded(engine.url), dialect_of(engine.url).writing(engine) as connection:
        _require_user(connection, user, role, shown(engine.url))
        with kept_rights(connection, but=user):
            take(connection, user)
            give(connection, role, user)
    logger.info("Granted the role %s in %s", role, shown(engine.url))


def _require_user(connection: Connection, user: str, role: str, where: str) -> None:
    """Refuse a user that does not exist, and taking the owner's rights."""
    if not connection.scalar(text("SELECT COUNT(*) FROM pg_roles WHERE rolname = :name"), {"name": user}):
        msg = f"The server of {where} has no user '{user}'. Let its administrator make one by CREATE ROLE ... LOGIN."
        raise DatabaseError(msg)
    owns = "SELECT pg_get_userbyid(relowner), pg_has_role(relowner, 'USAGE') FROM pg_class WHERE oid = 'run'::regclass"
    owner, is_ours = connection.execute(text(owns)).one()
    if not is_ours:
        # The server would only warn that nothing was granted.
        msg = f"Rights on {where} are given by its owner, '{owner}'. Connect as that user, or as a superuser."
        raise DatabaseError(msg)
    if owner == user and role != "owner":
        msg = f"The user '{user}' owns the database {where}. Make another one its owner first, with --role owner."
        raise DatabaseError(msg)
