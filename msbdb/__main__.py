"""The command ``msbdb`` as ``python -m msbdb``, for an interpreter whose scripts are not on the path."""

from msbdb.cli.main import main

if __name__ == "__main__":
    main()
