"""The one CRS of a database, and its row in ``spatial_ref_sys``."""

import hashlib
import warnings
from typing import TYPE_CHECKING

from sqlalchemy import Connection, text

from msbdb.errors import CRSError

if TYPE_CHECKING:
    from pyproj import CRS

FIRST_OWN_SRID = 910_000

OWN_SRIDS = 88_999
"""PostGIS reserves 910000 to 998999 for CRSs of users."""


def srid_of(epsg: int, crs_wkt: str) -> int:
    """Return the SRID under which a CRS is registered.

    Parameters
    ----------
    epsg : int
        EPSG code of the horizontal CRS; 0 for a CRS without code.
    crs_wkt : str
        The CRS as WKT, used without a code.

    Returns
    -------
    int
        The EPSG code, or a number from PostGIS's range for users that depends on the WKT alone.
    """
    if epsg > 0:
        return epsg
    text_ = horizontal(crs_from(0, crs_wkt)).to_wkt("WKT2_2019")
    digest = hashlib.blake2b(text_.encode(), digest_size=8).digest()
    return FIRST_OWN_SRID + int.from_bytes(digest, "little") % OWN_SRIDS


def crs_from(epsg: int, crs_wkt: str) -> "CRS":
    """Return the CRS of a code, or of a WKT when there is no code.

    Raises
    ------
    CRSError
        When PROJ knows neither.
    """
    # PROJ is imported here: a database whose CRS has a code is opened without it.
    from pyproj import CRS
    from pyproj.exceptions import CRSError as ProjError

    try:
        return CRS.from_epsg(epsg) if 0 < epsg < FIRST_OWN_SRID else CRS.from_wkt(crs_wkt)
    except ProjError as error:
        msg = f"The database needs a CRS; got EPSG code {epsg} and WKT '{crs_wkt[:60]}'. Give a known EPSG code."
        raise CRSError(msg) from error


def horizontal(crs: "CRS") -> "CRS":
    """Return the horizontal part of a compound CRS, and any other CRS unchanged."""
    return crs.sub_crs_list[0] if crs.is_compound else crs


def register(connection: Connection, srid: int, crs: "CRS") -> None:
    """Write a CRS into ``spatial_ref_sys`` unless it has the SRID already; both dialects get the same text.

    Raises
    ------
    CRSError
        When the CRS is not projected in metres.
    """
    from msbdb.grid import require_metric

    crs = horizontal(crs)
    require_metric(crs)
    if connection.scalar(text("SELECT count(*) FROM spatial_ref_sys WHERE srid = :srid"), {"srid": srid}):
        return
    with warnings.catch_warnings():
        # The PROJ string lacks the datum; the table requires it, but clients read the WKT.
        warnings.simplefilter("ignore", UserWarning)
        proj4 = crs.to_proj4()
    row = {
        "srid": srid,
        "auth_name": "epsg" if srid < FIRST_OWN_SRID else "msbdb",
        "auth_srid": srid,
        "ref_sys_name": crs.name,
        "proj4text": proj4,
        "srtext": crs.to_wkt("WKT1_GDAL"),
    }
    if connection.dialect.name == "postgresql":
        del row["ref_sys_name"]
    names = ", ".join(row)
    values = ", ".join(f":{name}" for name in row)
    connection.execute(text(f"INSERT INTO spatial_ref_sys ({names}) VALUES ({values})"), row)  # noqa: S608  (our names)
