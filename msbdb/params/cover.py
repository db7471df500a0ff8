"""Parameters of telling roofs from vegetation by structure."""

from dataclasses import dataclass

from msbdb.params.declare import param


@dataclass(frozen=True, slots=True)
class CoverParams:
    """Telling roofs from vegetation by texture and echoes; all calibrated together on the tiles at hand."""

    window_m: float = param(
        1.5,
        unit="m",
        low=0.5,
        high=20.0,
        source="ours: smaller than the narrowest roof plane",
        doc="Small window of the texture.",
    )
    wide_window_m: float = param(
        2.5, unit="m", low=0.5, high=20.0, source="ours: enough echoes for a share", doc="Wide window of the texture."
    )
    split_weight: float = param(
        8.0,
        unit="1",
        low=0.0,
        high=100.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Log-odds a share of split first echoes, small window.",
    )
    split_wide_weight: float = param(
        3.5,
        unit="1",
        low=0.0,
        high=100.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Log-odds a share of split first echoes, wide window.",
    )
    solid_weight: float = param(
        2.0,
        unit="1",
        low=0.0,
        high=100.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Log-odds a share of last echoes that stop near the surface.",
    )
    echo_rough_weight: float = param(
        0.15,
        unit="1",
        low=0.0,
        high=100.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Log-odds a factor e of roughness, beside the echoes.",
    )
    echo_bias: float = param(
        -1.2,
        unit="1",
        low=-50.0,
        high=50.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Log-odds without any evidence.",
    )
    rough_weight: float = param(
        1.5,
        unit="1",
        low=0.0,
        high=100.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Log-odds a factor e of roughness, without echoes.",
    )
    rough_m: float = param(
        0.25,
        unit="m",
        low=0.01,
        high=10.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Roughness in the small window that tells nothing.",
    )
    rough_wide_m: float = param(
        0.35,
        unit="m",
        low=0.01,
        high=10.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Roughness in the wide window that tells nothing.",
    )
    smooth_floor_m: float = param(
        0.02,
        unit="m",
        low=0.001,
        high=1.0,
        source="ours: the range noise of a scanner",
        doc="Least roughness that is told.",
    )
    smooth_m: float = param(
        2.0,
        unit="m",
        low=0.0,
        high=20.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Sigma of the smoothing of the odds.",
    )
    neck_m: float = param(
        1.2, unit="m", low=0.0, high=20.0, source="ours: hedges and walls are thinner", doc="Thinner roofs are cut."
    )
    blind_neck_m: float = param(
        2.0,
        unit="m",
        low=0.0,
        high=20.0,
        source="ours: roughness alone mistakes more crowns",
        doc="The same, without echoes.",
    )
    hole_m2: float = param(
        20.0,
        unit="m2",
        low=0.0,
        high=1e4,
        source="ours: the finest scale",
        doc="Smaller holes of a roof, above the mask, are filled.",
    )
    min_roof_m2: float = param(
        10.0, unit="m2", low=0.0, high=1e4, source="ours: the finest scale", doc="Smaller regions are no roof."
    )
    smooth_m_limit: float = param(
        0.12,
        unit="m",
        low=0.01,
        high=5.0,
        source="ours: three times a scanner's range noise",
        doc="Cells below it are smooth.",
    )
    min_smooth_share: float = param(
        0.3,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Least smooth share of a roof, without echoes.",
    )
    smooth_per_split: float = param(
        3.0,
        unit="1",
        low=0.0,
        high=100.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Smooth share that a roof needs a share of split echoes.",
    )
    free_split_share: float = param(
        0.05,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: what edges and chimneys split",
        doc="Split share that needs no smooth cells.",
    )
    green_share: float = param(
        0.6,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: crowns of Nîmes that stop every pulse are 90 % green, its roofs at most 20 %",
        doc="Regions with this share of vegetation's colour are vegetation unless they are smooth.",
    )
    green_smooth_share: float = param(
        0.7,
        unit="1",
        low=0.0,
        high=1.0,
        source="ours: crowns reach 60 % of smooth cells, flat and pitched roofs have 70 to 90 %",
        doc="Share of smooth cells from which a green region is a green roof.",
    )
    grow_m: float = param(
        1.0,
        unit="m",
        low=0.0,
        high=20.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Width of the edge that is given back to roofs.",
    )
    grow_step_m: float = param(
        1.0,
        unit="m",
        low=0.0,
        high=20.0,
        source="ours: calibrated together, on four surveys and thinned copies",
        doc="Largest step in height to a cell that is given back.",
    )
