from . import (
    camera as camera,
)
from . import (
    dataset as dataset,
)
from . import (
    errors as errors,
)
from . import (
    factory as factory,
)
from . import (
    families as families,
)
from . import (
    geometry as geometry,
)
from . import (
    matching as matching,
)
from . import (
    optics as optics,
)
from . import (
    reconstruction as reconstruction,
)
from . import (
    rendering as rendering,
)
from . import (
    report as report,
)
from . import (
    scenes as scenes,
)
from . import (
    scoring as scoring,
)
from . import (
    sensor as sensor,
)
from . import (
    studies as studies,
)
from .camera import (
    Annulus as Annulus,
)
from .camera import (
    BareAperture as BareAperture,
)
from .camera import (
    BrownConrady as BrownConrady,
)
from .camera import (
    Camera as Camera,
)
from .camera import (
    Correspondence as Correspondence,
)
from .camera import (
    Disk as Disk,
)
from .camera import (
    KannalaBrandt as KannalaBrandt,
)
from .camera import (
    MaskAperture as MaskAperture,
)
from .camera import (
    Misalignment as Misalignment,
)
from .camera import (
    Pinhole as Pinhole,
)
from .camera import (
    Polygon as Polygon,
)
from .camera import (
    Rig as Rig,
)
from .camera import (
    ThinLens as ThinLens,
)
from .camera import (
    Truth as Truth,
)
from .camera import (
    film_image as film_image,
)
from .camera import (
    undistort_maps as undistort_maps,
)
from .camera.diffraction import (
    diffract as diffract,
)
from .camera.multiview import (
    essential_matrix as essential_matrix,
)
from .camera.multiview import (
    fundamental_matrix as fundamental_matrix,
)
from .camera.multiview import (
    triangulate as triangulate,
)
from .camera.rectification import (
    rectify as rectify,
)
from .dataset import (
    Dataset as Dataset,
)
from .errors import (
    TwinlensError as TwinlensError,
)
from .matching import (
    StereoMatcher as StereoMatcher,
)
from .matching import (
    birchfield_tomasi as birchfield_tomasi,
)
from .matching import (
    census as census,
)
from .matching import (
    jaccard as jaccard,
)
from .matching import (
    match as match,
)
from .matching import (
    ncc as ncc,
)
from .matching import (
    rank as rank,
)
from .matching import (
    sad as sad,
)
from .matching import (
    ssd as ssd,
)
from .matching import (
    zncc as zncc,
)
from .matching import (
    zsad as zsad,
)
from .matching import (
    zssd as zssd,
)
from .rendering import (
    correspondence as correspondence,
)
from .rendering import (
    ground_truth as ground_truth,
)
from .rendering import (
    render as render,
)
from .rendering import (
    render_lens_grid as render_lens_grid,
)
from .scenes import (
    Scene as Scene,
)
from .scenes import (
    bundled_scenes as bundled_scenes,
)
from .scenes import (
    load_scene as load_scene,
)
from .scoring import (
    agreement as agreement,
)
from .scoring import (
    evaluate as evaluate,
)
from .sensor import (
    Exposure as Exposure,
)
from .sensor import (
    Mismatch as Mismatch,
)
from .sensor import (
    Sensor as Sensor,
)
from .sensor import (
    auto_exposure as auto_exposure,
)
from .studies import (
    study as study,
)

__version__: str

__all__ = [
    "Annulus",
    "BareAperture",
    "BrownConrady",
    "Camera",
    "Correspondence",
    "Dataset",
    "Disk",
    "Exposure",
    "KannalaBrandt",
    "MaskAperture",
    "Misalignment",
    "Mismatch",
    "Pinhole",
    "Polygon",
    "Rig",
    "Scene",
    "Sensor",
    "StereoMatcher",
    "ThinLens",
    "Truth",
    "TwinlensError",
    "agreement",
    "auto_exposure",
    "birchfield_tomasi",
    "bundled_scenes",
    "camera",
    "census",
    "correspondence",
    "dataset",
    "diffract",
    "errors",
    "essential_matrix",
    "evaluate",
    "factory",
    "families",
    "film_image",
    "fundamental_matrix",
    "geometry",
    "ground_truth",
    "jaccard",
    "load_scene",
    "match",
    "matching",
    "ncc",
    "optics",
    "rank",
    "reconstruction",
    "rectify",
    "render",
    "render_lens_grid",
    "rendering",
    "report",
    "sad",
    "scenes",
    "scoring",
    "sensor",
    "ssd",
    "studies",
    "study",
    "triangulate",
    "undistort_maps",
    "zncc",
    "zsad",
    "zssd",
]
