"""Strings of the GEM Building Taxonomy, versions 3.3 and 4.0, of what is known about a building.

A string has the known attributes, such as ``HAPP:3+HHT:9.5/Y:1950/PLFR+BP1/RES``. An attribute that is not known is
left out, as these versions have no atom for it; a building about which nothing is known is ``UNK``.
"""

import re
from dataclasses import dataclass

UNKNOWN = "UNK"
"""What is not known."""

OCCUPANCIES = {
    "RES": ("residential", "housing", "house", "apartments", "dwelling"),
    "COM": ("commercial", "retail", "office", "public"),
    "IND": ("industrial", "industry"),
    "AGR": ("agriculture", "agricultural", "farm"),
    "GOV": ("government", "administration"),
    "EDU": ("education", "school", "university"),
    "HEA": ("health", "healthcare", "hospital"),
    "TRT": ("transport", "transportation"),
    "NONRES": ("non-residential", "nonresidential"),
    "OCO": ("other",),
}
"""The classes of occupancy, with words that mean the same."""

_OCCUPANCY = re.compile(r"(RES|COM|IND|AGR|GOV|EDU|HEA|TRT)(:[0-9]+[A-Z]?)?|NONRES|OCO|MIX\([A-Z]{3,6}(;[A-Z]{3,6})+\)")

_YEAR = re.compile(r"[0-9]{4}(-[0-9]{4})?|[<>][0-9]{4}")

_ATOMS = re.compile(r"[A-Z][A-Z0-9]*(\+[A-Z][A-Z0-9]*)*")


@dataclass(frozen=True, slots=True)
class Described:
    """What is known about a building, as atoms of the taxonomy; `UNKNOWN` for what is not.

    Parameters
    ----------
    material, llrs : str
        Material and type of the lateral load-resisting system, such as MUR and LWAL.
    height : str
        Storeys and height: HAPP and HHT.
    year : str
        Date of construction: Y.
    shape, position : str
        Shape of the plan and position within the block.
    occupancy : str
        Its class.
    """

    material: str = UNKNOWN
    llrs: str = UNKNOWN
    height: str = UNKNOWN
    year: str = UNKNOWN
    shape: str = UNKNOWN
    position: str = UNKNOWN
    occupancy: str = UNKNOWN

    @property
    def string(self) -> str:
        """The taxonomy string.

        Examples
        --------
        >>> Described(height=height_atoms(3, 9.46), shape="PLFR", position="BPD").string
        'HAPP:3+HHT:9.5/PLFR+BPD'
        >>> Described().string
        'UNK'
        """
        plan = "+".join(atom for atom in (self.shape, self.position) if atom != UNKNOWN) or UNKNOWN
        attributes = (self.material, self.llrs, self.height, self.year, plan, self.occupancy)
        return "/".join(own for own in attributes if own != UNKNOWN) or UNKNOWN


def height_atoms(storeys: int | None, height_m: float | None) -> str:
    """Return HAPP with the number of storeys, as an estimate, and HHT with the height in metres, from 1 m on."""
    atoms = [] if not storeys else [f"HAPP:{storeys}"]
    if height_m is not None and height_m >= 1:
        atoms.append(f"HHT:{height_m:.1f}")
    return "+".join(atoms) or UNKNOWN


def occupancy_atom(value: str) -> str:
    """Return the class of occupancy that a value names, or `UNKNOWN`.

    Examples
    --------
    >>> occupancy_atom("RES:2"), occupancy_atom("School"), occupancy_atom("castle")
    ('RES:2', 'EDU', 'UNK')
    """
    text = value.strip()
    if _OCCUPANCY.fullmatch(text.upper()):
        return text.upper()
    return next((code for code, words in OCCUPANCIES.items() if text.lower() in words), UNKNOWN)


def year_atom(value: str) -> str:
    """Return the date of construction: a year, a date, a range such as 1950-1960, or a limit such as <1950.

    Examples
    --------
    >>> year_atom("1950"), year_atom("1950-06-01"), year_atom("1950-1960"), year_atom("old")
    ('Y:1950', 'Y:1950', 'Y:1950-1960', 'UNK')
    """
    text = value.strip().removesuffix(".0")
    if re.match(r"[0-9]{4}-[0-9]{2}(-|$)", text):
        text = text[:4]
    return f"Y:{text}" if _YEAR.fullmatch(text) else UNKNOWN


def other_atoms(value: str) -> str:
    """Return atoms of another attribute as they are given, or `UNKNOWN` where the value has not their form."""
    text = value.strip().upper()
    return text if _ATOMS.fullmatch(text) else UNKNOWN
