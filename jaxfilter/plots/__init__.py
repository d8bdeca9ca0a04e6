"""Pictures for papers: of clouds, labels and sweeps.

Every function draws into the given Axes, or into a figure of its own, and returns the Axes; ``ax.figure.savefig`` saves
it. Those that draw several panels return the Figure. No global matplotlib state is touched. Coordinates are local metres,
as in ``PointCloud.xyz``. The colours of errors are from Okabe and Ito's palette, which stay apart for colour-blind readers.

>>> ax = jf.plots.hillshade(cloud.xyz[result.ground])
>>> jf.plots.profile(cloud, result, ((0, 10), (60, 10)), ax=ax) is ax
True
"""

from .maps import GROUND_COLOUR as GROUND_COLOUR
from .maps import OBJECT_COLOUR as OBJECT_COLOUR
from .maps import PICTURE_CELLS as PICTURE_CELLS
from .maps import PICTURE_REACH as PICTURE_REACH
from .maps import TYPE_1 as TYPE_1
from .maps import TYPE_2 as TYPE_2
from .maps import doubt_map as doubt_map
from .maps import error_map as error_map
from .maps import footprints as footprints
from .maps import hillshade as hillshade
from .maps import panel as panel
from .maps import profile as profile
from .maps import rasterise as rasterise
from .sweeps import sweep_curve as sweep_curve
from .sweeps import sweep_curves as sweep_curves
from .sweeps import sweep_map as sweep_map
from .sweeps import sweep_maps as sweep_maps
from .sweeps import votes_map as votes_map
