"""Parameters of the flat regions."""

from dataclasses import dataclass

from msbdb.params.declare import param


@dataclass(frozen=True, slots=True)
class FlatRegionParams:
    """Flat regions by differential morphological and attribute profiles."""

    on: str = param(
        "ndsm",
        unit="-",
        choices=("ndsm", "surface"),
        source="M27: the paper itself recommends a ground filter against plateaus",
        doc="Seek flat regions on heights above ground, or on the raw surface as the paper does.",
    )
    s_max_m: float = param(
        1.5,
        unit="m",
        low=0.0,
        high=50.0,
        source="M11 gives 3.0; ours: that takes narrow roofs and corners with it, 1 to 2 m do as well against crowns",
        doc="S_I: largest window of the profile that finds outliers.",
    )
    valley_factor: float = param(
        0.0,
        unit="cells",
        low=0.0,
        high=100.0,
        source="M10 gives 2; ours: where one or two pulses hit a cell, valleys are what tells a crown from a roof",
        doc="A valley this many times R_g deep is an outlier; 0 keeps valleys.",
    )
    peak_factor: float = param(
        2.0,
        unit="cells",
        low=0.0,
        high=100.0,
        source="M10 gives 4 to spare roofs, with windows twice as wide; ours: crowns lose their tips",
        doc="The same for peaks; 0 keeps peaks.",
    )
    gradients: str = param(
        "initial",
        unit="-",
        choices=("initial", "denoised"),
        source="ours: what denoising smooths over is what tells crowns; M13 takes the denoised surface",
        doc="The surface of which the gradients are summed.",
    )
    gradient_window_m: float = param(
        0.9,
        unit="m",
        low=0.0,
        high=20.0,
        source="ours: M13 states none; as wide at any cell, so that gradients compare; 1.2 m loses roofs",
        doc="Window of the gradients, at least 3 cells.",
    )
    gradient_cap_m: float = param(
        1.5,
        unit="m",
        low=0.0,
        high=1000.0,
        source="ours: half a storey; without a cap the foot of a tower makes its podium rough",
        doc="A gradient counts as no more than this; 0 sets no cap, which the raw surface needs.",
    )
    lambda_min_m2: float = param(
        20.0, unit="m2", low=0.0, high=1e6, source="M23: 30, 20, 20", doc="λ_min: sum of gradients of the first zone."
    )
    lambda_max_m2: float = param(
        40_000.0, unit="m2", low=0.0, high=1e9, source="M23: 40000", doc="λ_max: sum of gradients of the last zone."
    )
    lambda_step_m2: float = param(
        20.0,
        unit="m2",
        low=0.0,
        high=1e6,
        source="M23 gives 250, 500, 300, against plateaus; ours: heights above ground have none, and small roofs gain",
        doc="λ_Δ: width of a zone.",
    )
    ratio: float = param(
        2.0,
        unit="1/m",
        low=0.0,
        high=100.0,
        source="M17, M23 give 1.5; ours: with capped gradients 1.9 to 2.2 do best",
        doc="R: a flat region has at least R times its zone's upper λ of area; less in cells above 0.35 m.",
    )
    largest_m2: float = param(
        50_000.0,
        unit="m2",
        low=0.0,
        high=1e9,
        source="ours: λ_max alone takes all the ground of a tile of a few hectares for one building",
        doc="Larger flat regions are terrain; 0 sets no limit.",
    )
    opening_m: float = param(
        1.5,
        unit="m",
        low=0.0,
        high=50.0,
        source="M19 gives 3; ours: that cuts roofs of 3 m and all that trees indent",
        doc="Window of the opening and closing of flat regions.",
    )
    max_compactness: float = param(
        30.0,
        unit="1",
        low=1.0,
        high=1e6,
        source="M20, M23 give 9, 11, 10.5; ours: connected blocks of an old town reach 18, and 30 is 93 to 1",
        doc="ψ: regions of this P²/(4πA) or more are too long and thin.",
    )
    grow_m: float = param(
        0.9,
        unit="m",
        low=0.0,
        high=20.0,
        source="ours: lowest points lie beside or below a roof in the cells of its edge",
        doc="Width of the edge that is given back to regions on heights above ground.",
    )
    grow_step_m: float = param(
        1.0,
        unit="m",
        low=0.0,
        high=20.0,
        source="ours: as for the cover; 0.3 to 2 m differ little",
        doc="Largest step in height to a cell that is given back.",
    )
