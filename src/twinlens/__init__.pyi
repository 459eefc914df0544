from . import (
    calibrations as calibrations,
    camera as camera,
    dataset as dataset,
    errors as errors,
    factory as factory,
    families as families,
    geometry as geometry,
    matching as matching,
    optics as optics,
    reconstruction as reconstruction,
    rendering as rendering,
    report as report,
    scenes as scenes,
    scoring as scoring,
    sensor as sensor,
    studies as studies,
)
from .calibrations.trajectories import read_trajectory as read_trajectory
from .camera import (
    Annulus as Annulus,
    BareAperture as BareAperture,
    BrownConrady as BrownConrady,
    Camera as Camera,
    Correspondence as Correspondence,
    Decoded as Decoded,
    Disk as Disk,
    Dual as Dual,
    GrayCode as GrayCode,
    Grid as Grid,
    KannalaBrandt as KannalaBrandt,
    MaskAperture as MaskAperture,
    Masks as Masks,
    Misalignment as Misalignment,
    PhaseShift as PhaseShift,
    Pinhole as Pinhole,
    Polygon as Polygon,
    Projection as Projection,
    Projector as Projector,
    Quad as Quad,
    Rig as Rig,
    ThinLens as ThinLens,
    Truth as Truth,
    decode as decode,
    dual_pixel_disparity as dual_pixel_disparity,
    film_image as film_image,
    light_field_rig as light_field_rig,
    refocus as refocus,
    undistort_maps as undistort_maps,
)
from .camera.film import diffract as diffract
from .camera.multiview import (
    essential_matrix as essential_matrix,
    fundamental_matrix as fundamental_matrix,
    triangulate as triangulate,
)
from .camera.parts import aperture_points as aperture_points
from .camera.rectification import rectify as rectify
from .dataset import Dataset as Dataset, collate as collate
from .dataset.poses import read_rig as read_rig, write_rig as write_rig
from .errors import TwinlensError as TwinlensError
from .geometry.motion import (
    Keyframe as Keyframe,
    Motion as Motion,
    Trajectory as Trajectory,
    Turn as Turn,
)
from .matching import (
    ApertureSamples as ApertureSamples,
    StereoMatcher as StereoMatcher,
    all_in_focus as all_in_focus,
    birchfield_tomasi as birchfield_tomasi,
    census as census,
    cost_curve as cost_curve,
    inverse_depth_bound as inverse_depth_bound,
    inverse_depth_from_defocus as inverse_depth_from_defocus,
    inverse_depth_from_focus as inverse_depth_from_focus,
    jaccard as jaccard,
    match as match,
    ncc as ncc,
    rank as rank,
    sad as sad,
    sharpness as sharpness,
    ssd as ssd,
    zncc as zncc,
    zsad as zsad,
    zssd as zssd,
)
from .optics.planning import plan_rig as plan_rig
from .optics.rig_task import RigTask as RigTask
from .rendering import (
    correspondence as correspondence,
    focal_stack as focal_stack,
    ground_truth as ground_truth,
    projection as projection,
    render as render,
    render_lens_grid as render_lens_grid,
    render_light_field as render_light_field,
)
from .scenes import (
    Scene as Scene,
    bundled_scenes as bundled_scenes,
    load_scene as load_scene,
)
from .scoring import agreement as agreement, evaluate as evaluate
from .sensor import (
    Exposure as Exposure,
    Mismatch as Mismatch,
    Sensor as Sensor,
    auto_exposure as auto_exposure,
)
from .studies import study as study

__version__: str
