"""Parameters of the spectral classes."""

from dataclasses import dataclass

from msbdb.params.declare import param


@dataclass(frozen=True, slots=True)
class SpectralParams:
    """Classes of land cover, and what they remove."""

    classes: int = param(15, unit="count", low=2, high=250, source="V35", doc="K of k-means.")
    seed: int = param(0, unit="-", low=0, high=2**31 - 1, source="ours: the paper states none", doc="Seed of k-means.")
    sample: int = param(
        100_000,
        unit="count",
        low=100,
        high=10_000_000,
        source="ours: centres from a sample are as good and cost a fixed time",
        doc="Cells on which k-means is fitted.",
    )
    filter_share: float = param(
        0.8,
        unit="1",
        low=0.0,
        high=1.0,
        source="V34: 'a bit smaller than the smallest building'",
        doc="Area of the bands' open-close filter as a share of the finest scale.",
    )
    tail_percent: float = param(
        2.0,
        unit="%",
        low=0.0,
        high=40.0,
        source="ours: V21, the paper states no normalisation; a glint must not squeeze all other values together",
        doc="Percentile of each band that becomes 0; that of 100 less it becomes 1.",
    )
    vegetation_index: str = param(
        "auto",
        unit="-",
        choices=("auto", "ndvi", "pseudo-ndvi", "green-red"),
        source="V20, V36; ours: on real surveys green-red tells crowns from roofs far better than pulse intensity",
        doc="Evidence of leaves; 'auto' takes NDVI where near infrared exists, else green-red, else pseudo-NDVI.",
    )
    ndvi_bounds: tuple[float, ...] = param(
        (0.0, 0.2),
        unit="1",
        low=-1.0,
        high=1.0,
        source="ours: roofs lie below the first in every orthophoto seen, lit crowns above the second",
        doc="Lowest and highest threshold of NDVI; Otsu's method finds the value between them.",
    )
    green_red_bounds: tuple[float, ...] = param(
        (0.0, 0.1),
        unit="1",
        low=-1.0,
        high=1.0,
        source="ours: as for NDVI, wide enough for the colour balance of different cameras",
        doc="Lowest and highest threshold of (green - red) / (green + red).",
    )
    pseudo_ndvi_bounds: tuple[float, ...] = param(
        (0.0, 0.4),
        unit="1",
        low=-1.0,
        high=1.0,
        source="ours: the index of the scaled bands spreads about twice as wide as NDVI",
        doc="Lowest and highest threshold of the index of intensity and red, both scaled to 0 to 1.",
    )
    smooth_m: float = param(
        0.05,
        unit="m",
        low=0.0,
        high=10.0,
        source="ours: plain roofs show 0.003 to 0.05 m on real surveys, hedges and crowns 0.06 to 3 m",
        doc="A green class smoother than this is a planted roof, not a crown.",
    )
    rough_m: float = param(
        0.5,
        unit="m",
        low=0.0,
        high=100.0,
        source="ours: the roughest roof classes seen show 0.4 to 0.46 m, at cells of 0.5 and 1 m",
        doc="Roughness of a sure crown: at it the index may lie farthest below its threshold.",
    )
    leafless_share: float = param(
        0.5,
        unit="1",
        low=0.0,
        high=2.0,
        source="ours: crowns that are bare or in shadow lie a little below the threshold on real surveys",
        doc="From smooth_m to rough_m, the index a crown needs falls by this share of the width of its bounds.",
    )
    clutter_m: float = param(
        1.0,
        unit="m",
        low=0.0,
        high=100.0,
        source="ours: twice the roughest roof class seen",
        doc="A class rougher than this that is not green enough for a crown is neither: masts, cranes, fences.",
    )
    shadow_brightness: float = param(
        0.15,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: V36 leaves it to the operator; smooth dark classes are roofs in shadow or dark roofs (V43)",
        doc="A class darker than this is shadow, unless it is known to be smoother than rough_m.",
    )
    water_ndvi: float = param(
        -0.3,
        unit="1",
        low=-1.0,
        high=1.0,
        source="ours: roofs lie above, open water below",
        doc="A smooth class whose NDVI is below this is water; needs a near-infrared band.",
    )
    decides: str = param(
        "structure",
        unit="-",
        choices=("structure", "spectral"),
        source="ours: echoes and texture tell crowns better",
        doc="What tells roofs from vegetation where there is imagery: structure, or colours alone (V36 to V41).",
    )
    min_building_share: float = param(
        0.3,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: V41 removes at no pixel at all, which is lax (V43)",
        doc="A part with a smaller share of building classes is removed.",
    )
    split_share: float = param(
        0.0,
        unit="1",
        low=0.0,
        high=0.5,
        source="V44: 0.4, as the vu2009 profile; ours: 15 classes of fewer materials differ by noise, and cut roofs",
        doc="A part is split when its second class reaches this share; 0 never splits.",
    )
