"""Images and truth that several tests look at: each job makes a dictionary of arrays."""

import contextlib
from dataclasses import replace

import numpy as np

import twinlens as tl
from tests.rendering import rendering_photos as photos
from twinlens.camera import Rig


def edge_job() -> dict[str, np.ndarray]:
    """Images of edges of light, whose profiles have closed forms."""
    return {name: edge(*row) for name, row in photos.EDGES.items()}


def edge(camera, lens, z, axis, position) -> np.ndarray:
    scene = photos.half_plane(z, **{axis: position})
    return tl.render(
        scene, Rig([camera], [photos.POSE]), lens_of(lens), spp=1024, seed=1
    )[0]


def lens_of(parameters):
    if parameters is None:
        return tl.Pinhole()
    diameter, distance = parameters
    return (
        tl.ThinLens(diameter, distance)
        if distance > 0
        else tl.BareAperture(diameter, -distance)
    )


def bokeh_job() -> dict[str, np.ndarray]:
    """A small light out of focus, through a triangle."""
    from twinlens.camera import Polygon

    camera, diameter, focus, z = photos.DOT
    lens = tl.ThinLens(diameter, focus, Polygon(3, rotation_deg=20))
    rig = Rig([camera], [photos.POSE])
    return {
        "far": tl.render(photos.dot(z, 0.02), rig, lens, spp=2048)[0],
        "near": tl.render(
            photos.dot(z, 0.02), rig, lens.replace(focus_distance=50.0), spp=2048
        )[0],
    }


def lens_job() -> dict[str, np.ndarray]:
    """Eight images each of one room: ours, Mitsuba's own camera's, and those of slightly wrong ones."""
    scene, camera = photos.room(), photos.camera(48, 36, 50.0)
    rig = Rig([camera], [photos.POSE])
    wide = tl.ThinLens(0.2, 2.5)
    seeds = range(8)
    found = {
        "ours": [tl.render(scene, rig, wide, spp=36, seed=seed)[0] for seed in seeds],
        "theirs": [mitsubas(scene, camera, wide, 36, seed + 100) for seed in seeds],
        "wrong focus": [
            mitsubas(scene, camera, wide.replace(focus_distance=2.0), 36, seed + 200)
            for seed in seeds
        ],
        "our pinhole": [tl.render(scene, rig, spp=36, seed=seed)[0] for seed in seeds],
        "their pinhole": [
            mitsubas(scene, camera, tl.Pinhole(), 36, seed + 300) for seed in seeds
        ],
    }
    return {name: np.array(images, dtype=float) for name, images in found.items()}


def mitsubas(scene, camera, lens, spp, seed) -> np.ndarray:
    """The scene through `thinlens` or `perspective`, as Mitsuba's manual has them; the camera must be centred."""
    import math

    from twinlens.rendering.backends import mitsuba
    from twinlens.rendering.build import build

    mi = mitsuba()
    eye, ahead, down = (photos.POSE[:3, column] for column in (3, 2, 1))
    kind = "thinlens" if lens.aperture_diameter else "perspective"
    opening = (
        {
            "aperture_radius": lens.aperture_diameter / 2,
            "focus_distance": 1 / lens.vergence,
        }
        if kind == "thinlens"
        else {}
    )
    sensor = {
        "type": kind,
        "fov": math.degrees(2 * math.atan(camera.width / 2 / camera.fx)),
        "near_clip": 0.01,
        "to_world": mi.ScalarTransform4f().look_at(
            origin=eye, target=eye + ahead, up=-down
        ),
        "film": {
            "type": "hdrfilm",
            "width": camera.width,
            "height": camera.height,
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "multijitter", "sample_count": spp},
    } | opening
    integrator = mi.load_dict(dict(scene.integrator))
    image = mi.render(
        build(scene).mi_scene,
        sensor=mi.load_dict(sensor),
        integrator=integrator,
        spp=spp,
        seed=seed,
    )
    return np.asarray(image)[..., :3]


def crop_job() -> dict[str, np.ndarray]:
    """An off-centre pair, and the centred images it is cut from."""
    scene, whole = photos.room(), photos.camera(81, 61, 50.0)
    part = whole.replace(width=40, height=30, cx=10.0, cy=19.0)
    left = Rig.stereo(part, 0.2, photos.POSE, right=part.replace(cx=17.0))
    large = Rig.stereo(whole, 0.2, photos.POSE)
    seeds = range(6)
    return {
        "parts": np.array(
            [tl.render(scene, left, spp=16, seed=seed) for seed in seeds], dtype=float
        ),
        "wholes": np.array(
            [tl.render(scene, large, spp=16, seed=seed + 50) for seed in seeds],
            dtype=float,
        ),
    }


def noise_job() -> dict[str, np.ndarray]:
    """Bytes and noise for seeds, cameras and threads."""
    scene, camera = photos.room(), photos.camera(64, 48, 60.0)
    twins = Rig([camera, camera], [photos.POSE, photos.POSE])
    lens = tl.ThinLens(0.1, 2.5)
    found = {"first": tl.render(scene, twins, lens, spp=8, seed=3)}
    for count in (1, 3, 64):
        with threads(count):
            found[f"threads {count}"] = tl.render(scene, twins, lens, spp=8, seed=3)
    found["other seed"] = tl.render(scene, twins, lens, spp=8, seed=4)
    found["long"] = tl.render(scene, twins, lens, spp=256, seed=5)
    return {name: np.array(images) for name, images in found.items()}


@contextlib.contextmanager
def threads(count: int):
    """Render with this number of threads inside."""
    import drjit

    before = drjit.thread_count()
    drjit.set_thread_count(count)
    yield
    drjit.set_thread_count(before)


def denoise_job() -> dict[str, np.ndarray]:
    """Denoised images of closed forms and of the room, and guides."""
    scene, camera = photos.room(), photos.camera(64, 48, 60.0)
    rig, sky = Rig([camera], [photos.POSE]), replace(scene, objects=())
    found = {"sky": tl.render(sky, rig, spp=4, denoise=True)[0]}
    for name in ("pinhole x", "far"):
        edge_camera, lens, z, axis, position = photos.EDGES[name]
        edge_camera = edge_camera.replace(height=48, cy=23.5)
        edge_scene = photos.painted_edge(z, **{axis: position})
        found[f"edge/{name}"] = tl.render(
            edge_scene,
            Rig([edge_camera], [photos.POSE]),
            lens_of(lens),
            spp=16,
            denoise=True,
        )[0]
    wide = tl.ThinLens(0.1, 2.5)
    for name, lens in (("pinhole", tl.Pinhole()), ("lens", wide)):
        found[f"{name}/raw"] = tl.render(
            scene, rig, lens, spp=2, seed=3, denoise=False
        )[0]
        found[f"{name}/denoised"] = tl.render(
            scene, rig, lens, spp=2, seed=3, denoise=True
        )[0]
        found[f"{name}/reference"] = tl.render(scene, rig, lens, spp=512, seed=4)[0]
    found["pinhole/raw by default"] = tl.render(scene, rig, spp=2, seed=3)[0]
    found["lens/grid"] = tl.render_lens_grid(
        scene, rig, [tl.Pinhole(), wide], spp=2, denoise=True
    )[1][0]
    found["own guides"] = np.array(
        [own_guides(scene, camera, wide, *key) for key in ((3, 0), (3, 1), (4, 0))]
    )
    for name, shown in photos.guided().items():
        guides = guides_of(shown, photos.camera(24, 24, 60.0))
        found |= {
            f"guide/{name}/albedo": guides.albedo,
            f"guide/{name}/normal": guides.normal,
        }
        found |= {
            f"path guide/{name}/{kind}": image
            for kind, image in guides_of_paths(shown).items()
        }
    passes = [("multijitter", 4, 1), ("independent", 3, 2)]
    found["guide/net/in passes"] = guides_of(
        photos.guided()["net"], photos.camera(24, 24, 60.0), passes
    ).albedo
    _, far, z, _, x = photos.EDGES["far"]
    lamp, passes = photos.half_plane(z, x=x), [("multijitter", 4, 6)]
    found["lamp/normal"] = (
        guides_of(lamp, photos.camera(), passes, lens_of(far)).normal
        @ -photos.POSE[:3, 2]
    )
    found["lamp/image"] = image_of(lamp, photos.camera(), lens_of(far), *passes[0])
    for count in (1, 3):
        with threads(count):
            found[f"threads {count}"] = tl.render(
                scene, rig, wide, spp=4, denoise=True
            )[0]
    return found


def estimate_job() -> dict[str, np.ndarray]:
    """Estimates of noise and true errors of eight seeds, and the samples that bounds need."""
    from twinlens.rendering import render_measured

    scene, camera = photos.room(), photos.camera(64, 48, 60.0)
    rig, wide = Rig([camera], [photos.POSE]), tl.ThinLens(0.1, 2.5)
    references = [tl.render(scene, rig, wide, spp=256, seed=seed)[0] for seed in (4, 5)]
    found = {}
    for name, denoise, spp in (
        ("raw", False, 4),
        ("denoised", True, 16),
    ):
        views = [
            render_measured(scene, rig, wide, spp, seed, denoise=denoise)[0][0]
            for seed in range(8)
        ]
        found[f"{name}/squared estimate"] = (
            np.array([view.error for view in views]) ** 2
        )
        apart = [
            np.array([view.image - reference for view in views])
            for reference in references
        ]
        found[f"{name}/squared error"] = (
            apart[0] * apart[1]
        )  # without the noise of the references
    tiny = Rig([photos.camera(8, 6)], [photos.POSE])
    rounds = iter([False, False, True])
    bounds = [lambda _: True, lambda _: next(rounds), lambda _: False]
    counts = [
        render_measured(scene, tiny, wide, 4, 0, enough=bound)[1] for bound in bounds
    ]
    return found | {"counts": np.array(counts)}


def denoised_optics_job() -> dict[str, np.ndarray]:
    """Denoised: slanted edges through lenses, the blur disk of a small light, and pairs with their reference."""
    edge_scene = photos.painted_edge(photos.SLANTED_Z, x=0.0)
    rolled = photos.rolled(photos.SLANT)
    found = {}
    for name, lens in photos.SLANTED_LENSES.items():
        rig = Rig([photos.camera(64, 64)], [rolled])
        images = [
            tl.render(edge_scene, rig, lens_of(lens), 16, seed, denoise=True)[0]
            for seed in range(96)
        ]
        found[f"slanted/{name}"] = np.mean(images, axis=0)
    camera, lens, z, radius = photos.DISK
    rig = Rig([camera], [photos.POSE])
    found["disk"] = tl.render(
        photos.dot(z, radius), rig, lens_of(lens), spp=256, denoise=True
    )[0]
    found["disk/raw"] = tl.render(
        photos.dot(z, radius), rig, lens_of(lens), spp=1024, seed=1
    )[0]
    scene, pair = (
        photos.room(),
        Rig.stereo(photos.camera(64, 48, 60.0), 0.2, photos.POSE),
    )
    wide, truth = tl.ThinLens(0.03, 2.5), tl.ground_truth(scene, pair, objects=False)[0]
    found |= {"disparity": truth.disparity, "visible": truth.visible}
    found["pair/denoised"] = np.array(
        [tl.render(scene, pair, wide, 16, seed, denoise=True) for seed in range(8)]
    )
    found["pair/reference"] = np.array([tl.render(scene, pair, wide, spp=4096, seed=9)])
    return found


def own_guides(scene, camera, lens, seed, eye):
    from twinlens.rendering.build import build
    from twinlens.rendering.images import other_guides
    from twinlens.rendering.views import View

    view = View(build(scene), camera, photos.POSE, lens, denoised=True)
    return other_guides(view, 4, seed, eye).albedo


def guides_of(scene, camera, passes=(("multijitter", 16, 5),), lens=tl.Pinhole()):  # noqa: B008
    from twinlens.rendering.build import build
    from twinlens.rendering.guides import render_guides

    return render_guides(build(scene), camera, photos.POSE, lens, passes)


def guides_of_paths(scene):
    """Guides from the paths of an image."""
    from twinlens.rendering.images import image_passes, raw_image
    from twinlens.rendering.views import views_of

    camera = photos.camera(24, 24, 60.0)
    rig = Rig([camera], [photos.POSE])
    (view,) = views_of({"rgb": scene}, rig, [tl.Pinhole()], 0, denoise=True)
    _, guides = raw_image(
        view, image_passes(camera, 256, 0, 0, "sobol"), None, lambda _: None
    )
    return {
        "albedo": guides.albedo,
        "normal": guides.normal,
        "random": guides.random_share,
    }


def image_of(scene, camera, lens, sampler, spp, seed):
    """Mitsuba's image, from one pass."""
    from twinlens.rendering.build import build
    from twinlens.rendering.sensors import make_sensor

    built = build(scene)
    sensor = make_sensor(camera, photos.POSE, lens, spp, sampler)
    return np.array(
        built.integrator.render(built.mi_scene, sensor, seed=seed, spp=spp)
    )[..., 0]


def count_job() -> dict[str, np.ndarray]:
    """Edges of light of radiance 1 seen with few samples: every pixel is a whole number of samples over their count."""
    from twinlens.rendering import samplers

    scene, rig = photos.half_plane(2.0, x=0.1234), Rig([photos.camera()], [photos.POSE])
    lens, usual = tl.ThinLens(0.3, 1.0), samplers.RAYS_PER_PASS
    found = {}
    for sampler in samplers.SAMPLERS:
        for spp in (1, 2, 3, 7, 8, 13, 32):
            found[f"{sampler}/{spp}"] = tl.render(
                scene, rig, lens, spp=spp, sampler=sampler
            )[0]
    samplers.RAYS_PER_PASS = 5 * 40 * 6  # room for five samples a pixel: passes of four
    done: list[float] = []
    found["narrow/13"] = tl.render(scene, rig, lens, spp=13, progress=done.append)[0]
    found["narrow/done"] = np.array(done)
    samplers.RAYS_PER_PASS = 1
    found["narrowest/5"] = tl.render(scene, rig, lens, spp=5)[0]
    samplers.RAYS_PER_PASS = 64 * 40 * 6
    many = [tl.render(scene, rig, lens, spp=1000, seed=seed)[0] for seed in range(4)]
    found["narrow mean"] = np.mean(many, axis=0)
    samplers.RAYS_PER_PASS = usual
    return found


def refusal_job() -> dict[str, np.ndarray]:
    """What `render` says to requests that cannot be met, "" where it renders."""
    from twinlens.camera import BrownConrady, Polygon
    from twinlens.errors import TwinlensError

    scene, camera = photos.half_plane(2.0, x=0.1), photos.camera(8, 6)
    lens = tl.ThinLens(0.1, 2.0)
    requests = {
        "spp 0": (camera, lens, {"spp": 0}),
        "spp -4": (camera, lens, {"spp": -4}),
        "spp 1.5": (camera, lens, {"spp": 1.5}),
        "spp True": (camera, lens, {"spp": True}),
        "seed -1": (camera, lens, {"seed": -1}),
        "seed 0.5": (camera, lens, {"seed": 0.5}),
        "sampler multijiter": (camera, lens, {"sampler": "multijiter"}),
        "sobol": (camera, lens, {"sampler": "sobol"}),
        "tall pixels": (camera.replace(fy=70.0), lens, {}),
        "odd centre": (camera.replace(cx=3.3), lens, {}),
        "distortion": (camera.replace(distortion=BrownConrady(k1=-0.1)), lens, {}),
        "polygon": (camera, lens.replace(aperture=Polygon(6)), {}),
        "infinity": (camera, lens.replace(focus_distance=float("inf")), {}),
        "bare hole": (camera, tl.BareAperture(0.1, 0.05), {}),
        "closed bare hole": (camera, tl.BareAperture(0.0, 0.05), {}),
        "closed polygon": (camera, tl.ThinLens(0.0, 1.0, Polygon(6)), {}),
        "half-pixel centre": (camera.replace(cx=2.5, cy=4.0), lens, {}),
        "numpy numbers": (camera, lens, {"spp": np.int64(2), "seed": np.uint32(1)}),
    }
    found = {}
    for name, (inside, front, options) in requests.items():
        try:
            tl.render(
                scene, Rig([inside], [photos.POSE]), front, **{"spp": 1, **options}
            )
            found[name] = ""
        except TwinlensError as error:
            found[name] = f"{type(error).__name__}: {error}"
    return {name: np.array(text) for name, text in found.items()}


JOBS = {
    "edge": edge_job,
    "bokeh": bokeh_job,
    "lens": lens_job,
    "crop": crop_job,
    "noise": noise_job,
    "denoise": denoise_job,
    "denoised optics": denoised_optics_job,
    "noise estimate": estimate_job,
    "count": count_job,
    "refusal": refusal_job,
}
