"""Named sets of values: the best that we know, and each paper's own."""

from typing import Any

from msbdb.errors import ParameterError
from msbdb.params.sections import Params, with_values

MONGUS: dict[str, Any] = {
    "on": "surface",
    "s_max_m": 3.0,
    "valley_factor": 2.0,
    "peak_factor": 4.0,
    "gradients": "denoised",
    "gradient_window_m": 0.0,
    "gradient_cap_m": 0.0,
    "lambda_min_m2": 30.0,
    "lambda_max_m2": 40_000.0,
    "lambda_step_m2": 250.0,
    "ratio": 1.5,
    "largest_m2": 0.0,
    "opening_m": 3.0,
    "max_compactness": 9.0,
    "grow_m": 0.0,
}
"""Mongus et al. 2013 as written, with Table 1's values of the data set DS1 (M23).

λ_max is made for square kilometres: where all the ground of a tile sums up to less, it is one flat region.
"""

CAO_WU: dict[str, Any] = {
    "mask_first": False,
    "histogram_tail_percent": 0.0,
    "thin_m": 0.0,
    "max_echo_share": 1.0,
    "max_crown": 1.0,
    "max_crown_curvature": 1.0,
    "max_ndvi": 1.0,
    "grow_m": 0.0,
    "grow_spacings": 0.0,
    "rectangularity_2": 0.4,
    "compactness": 3.0,
    "compactness_density": 0.0,
    "linearity": 0.45,
}
"""Cao & Wu as written; T_c, K, T_coc, R, E_s, n_b, n_s and σ_l, which they do not state, are ours."""


PROFILES: dict[str, dict[str, dict[str, Any]]] = {
    "default": {},
    "vu2009": {
        "surface": {"cell_m": 1.0},
        "ground": {"ground_filter": "wavelet"},
        "scale": {
            "scales_m2": (50.0, 100.0, 200.0, 500.0, 1000.0),
            "keep_courtyards": False,
            "merge_slivers": False,
            "fake_father_coverage": 0.0,
        },
        "spectral": {"decides": "spectral", "split_share": 0.4},
    },
    "mongus2013": {"flatregions": MONGUS},
    "mongus2013-ds2": {
        "flatregions": {**MONGUS, "lambda_min_m2": 20.0, "lambda_step_m2": 500.0, "max_compactness": 11.0}
    },
    "mongus2013-ds3": {
        "flatregions": {**MONGUS, "lambda_min_m2": 20.0, "lambda_step_m2": 300.0, "max_compactness": 10.5}
    },
    "cao-wu": {"ground": {"ground_filter": "quadratic", "quadratic_passes": 1}, "area3d": CAO_WU},
    "cao-wu-ss": {
        "ground": {"ground_filter": "quadratic", "quadratic_passes": 1},
        "area3d": {**CAO_WU, "most_heights": 1},
    },
    "adaptive": {"ground": {"ground_filter": "adaptive"}},
}
"""What each profile sets otherwise than the defaults."""


def profile(name: str = "default") -> Params:
    """Return the parameters of a named profile."""
    if name not in PROFILES:
        msg = f"There is no profile '{name}'; the profiles are {', '.join(PROFILES)}."
        raise ParameterError(msg)
    return with_values(Params(), PROFILES[name])
