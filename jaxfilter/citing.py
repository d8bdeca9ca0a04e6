"""What to cite for a method: BibTeX entries of the papers behind it."""

from __future__ import annotations

from typing import Any

from .core.errors import ParameterError

_ENTRIES = {
    "li2021": """@article{li2021fptd,
  author  = {Li, Hongfu and Ye, Chengming and Guo, Zixuan and Wei, Ruilong and Wang, Lixuan and Li, Jonathan},
  title   = {A Fast Progressive {TIN} Densification Filtering Algorithm for Airborne {LiDAR} Data Using Adjacent
             Surface Information},
  journal = {IEEE Journal of Selected Topics in Applied Earth Observations and Remote Sensing},
  volume  = {14},
  year    = {2021},
  doi     = {10.1109/JSTARS.2021.3131586}
}""",
    "axelsson2000": """@article{axelsson2000dem,
  author  = {Axelsson, Peter},
  title   = {{DEM} Generation from Laser Scanner Data Using Adaptive {TIN} Models},
  journal = {International Archives of Photogrammetry and Remote Sensing},
  volume  = {33},
  number  = {B4},
  pages   = {110--117},
  year    = {2000}
}""",
    "zhang2013": """@article{zhang2013filtering,
  author  = {Zhang, Jixian and Lin, Xiangguo},
  title   = {Filtering Airborne {LiDAR} Data by Embedding Smoothness-Constrained Segmentation in Progressive {TIN}
             Densification},
  journal = {ISPRS Journal of Photogrammetry and Remote Sensing},
  volume  = {81},
  pages   = {44--59},
  year    = {2013},
  doi     = {10.1016/j.isprsjprs.2013.04.001}
}""",
    "pingel2013": """@article{pingel2013improved,
  author  = {Pingel, Thomas J. and Clarke, Keith C. and McBride, William A.},
  title   = {An Improved Simple Morphological Filter for the Terrain Classification of Airborne {LIDAR} Data},
  journal = {ISPRS Journal of Photogrammetry and Remote Sensing},
  volume  = {77},
  pages   = {21--30},
  year    = {2013},
  doi     = {10.1016/j.isprsjprs.2012.12.002}
}""",
}

_PAPERS = {"fptd": ("li2021",), "ptd": ("axelsson2000", "zhang2013"), "smrf": ("pingel2013",)}


def citation(method: Any) -> str:
    """BibTeX for a method, given as its name, its class or an instance. Raises ParameterError for an unknown one."""
    if isinstance(method, str):
        name = method
    else:
        name = (method if isinstance(method, type) else type(method)).__name__
    if name.lower() not in _PAPERS:
        raise ParameterError(f"no citation for {name!r}; there are citations for {', '.join(_PAPERS)}")
    return "\n\n".join(_ENTRIES[key] for key in _PAPERS[name.lower()])
