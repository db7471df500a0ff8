"""Whether a database is what it says: every row is held against all that msbdb promises of it, enforced or not."""

from msbdb.database.integrity.finding import Finding
from msbdb.database.integrity.run import CHECKS, check_database

__all__ = ["CHECKS", "Finding", "check_database"]
