"""Care of a database: create, upgrade, copy, dump, check, grant rights, and the files of ``schema/``."""
