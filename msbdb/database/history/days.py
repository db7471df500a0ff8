"""Days of the inventory: from years and months to their first day, and none in the future."""

import datetime

from msbdb.errors import InputError

LAST_DAY = "9999-12-31"
"""A day after all surveys."""


def first_day(date: str) -> str:
    """Return the first day of a day, month or year of ISO 8601.

    Examples
    --------
    >>> first_day("2021"), first_day("2021-05"), first_day("2021-05-31")
    ('2021-01-01', '2021-05-01', '2021-05-31')
    """
    return date + "0000-01-01"[len(date) :]


def require_past(date: str, what: str) -> None:
    """Refuse a date that is none, or is in the future; a day after today is allowed, as it has begun in the east.

    Parameters
    ----------
    date : str
        A day, month or year of ISO 8601.
    what : str
        Whose date it is, for messages.

    Raises
    ------
    InputError
        With the next step.
    """
    tomorrow = datetime.datetime.now(datetime.UTC).date() + datetime.timedelta(days=1)
    try:
        begins = datetime.date.fromisoformat(first_day(date))
    except ValueError as error:
        msg = f"The date of {what} is written as 2021-05-31, 2021-05 or 2021; got '{date}'."
        raise InputError(msg) from error
    if begins > tomorrow:
        msg = f"The date of {what}, {date}, is in the future. Give the day on which the data were taken."
        raise InputError(msg)
