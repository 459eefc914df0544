"""Export of objects: COCO's annotations, and the scenes of the BOP benchmark of object poses. `export` has the dict.

Both have an image for every view, so pairs need not be rectified. Sources: https://cocodataset.org/#format-data;
docs/bop_datasets_format.md and scripts/calc_gt_info.py of https://github.com/thodan/bop_toolkit.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.distance import cdist

from twinlens.camera import ObjectTruth, Truth
from twinlens.camera.masks import encode_mask
from twinlens.dataset.channels import IMAGE
from twinlens.dataset.codecs.ply import encode_ply, read_ply
from twinlens.dataset.codecs.png import encode_png
from twinlens.dataset.layouts import Source, category
from twinlens.errors import InputError
from twinlens.geometry import Float, inverse

_LICENSE = 1
"""The number of the dataset's license in COCO's list."""
_MM = 1000.0
_DEPTH_SCALE = 0.1  # millimetres per unit of a depth image, or ten, a hundred times that if 16 bits need it


def coco(sources: Iterable[Source]) -> Iterator[tuple[str, bytes]]:
    """annotations/instances.json and images/<name>-im0.png ...: one annotation per visible object of each view.

    `segmentation`, `bbox` and `area` are of the visible part. Categories are those of `layouts.category`. Further keys
    have the whole object, its pose and its box. A dataset with splits has annotations/instances_<split>.json for each,
    too.
    """
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    categories: dict[str, int] = {}
    texts: Mapping[str, str] = {}
    for source in sources:
        texts = source.about
        for view, truth in enumerate(_truths(source)):
            image = {"id": len(images) + 1, **_coco_image(source, view)}
            images.append(image)
            yield f"images/{image['file_name']}", source.image(view)
            for instance in truth.objects:
                if instance.visible_pixel_count == 0:
                    continue
                name = truth.object_name(instance)
                kind = category(name, truth.object_names)
                number = categories.setdefault(kind, len(categories) + 1)
                annotation = {
                    "id": len(annotations) + 1,
                    "image_id": image["id"],
                    "category_id": number,
                    "name": name,
                }
                annotations.append(annotation | _annotation(truth, instance))
    head = _coco_head(texts, categories)
    yield "annotations/instances.json", _coco_file(head, images, annotations)
    for split in sorted({image["split"] for image in images if "split" in image}):
        part = [image for image in images if image.get("split") == split]
        name = f"annotations/instances_{split}.json"
        yield name, _coco_file(head, part, annotations)


def _coco_head(
    texts: Mapping[str, str], categories: Mapping[str, int]
) -> dict[str, Any]:
    """What a file of annotations says of all images: `texts` are those of `About`."""
    description = texts.get("description") or texts.get("name")
    info = {"description": description or "exported by twinlens"}
    for key, text in (("url", "url"), ("contributor", "creator"), ("date_created", "published")):  # fmt: skip
        if text in texts:
            info[key] = texts[text]
    licenses = []
    if license_name := texts.get("license"):
        is_address = license_name.startswith(("http://", "https://"))
        address = license_name if is_address else ""
        licenses = [{"id": _LICENSE, "name": license_name, "url": address}]
    numbered = [
        {"id": number, "name": name, "supercategory": ""}
        for name, number in categories.items()
    ]
    return {"info": info, "licenses": licenses, "categories": numbered}


def _coco_file(
    head: Mapping[str, Any],
    images: Sequence[Mapping[str, Any]],
    annotations: Sequence[Mapping[str, Any]],
) -> bytes:
    """A file of these images with those of the annotations that are of them."""
    numbers = {image["id"] for image in images}
    chosen = [item for item in annotations if item["image_id"] in numbers]
    content = {**head, "images": images, "annotations": chosen}
    return json.dumps(content, allow_nan=False).encode()


def _coco_image(source: Source, view: int) -> dict[str, Any]:
    rig = source.sample.rig
    camera = rig.cameras[view]
    licensed = {"license": _LICENSE} if source.about.get("license") else {}
    in_split = {"split": source.split} if source.split else {}
    return {
        **licensed,
        **in_split,
        "file_name": f"{source.name}-{IMAGE.name(view)}",
        "width": camera.width,
        "height": camera.height,
        "cam_K": camera.K.tolist(),
        "world_from_cam": rig.world_from_cams[view].tolist(),
    }


def _annotation(truth: Truth, instance: ObjectTruth) -> dict[str, Any]:
    size = list(truth.object_id.shape)
    corners: list[list[float]] = instance.corners_px.tolist()
    return {
        "iscrowd": 0,
        "bbox": list(instance.visible_box),
        "area": instance.visible_pixel_count,
        "segmentation": {
            "size": size,
            "counts": encode_mask(truth.object_id == instance.object_id),
        },
        "amodal_bbox": list(instance.box),
        "amodal_area": instance.pixel_count,
        "amodal_segmentation": {"size": size, "counts": instance.silhouette},
        "visible_fraction": instance.visible_fraction,
        "cam_from_object": instance.cam_from_object.tolist(),
        "extent": instance.extent.tolist(),
        "corners_px": [
            point if np.isfinite(point).all() else None for point in corners
        ],
    }


def bop(sources: Iterable[Source]) -> Iterator[tuple[str, bytes]]:
    """BOP scenes: train/<number>/ with scene_camera, scene_gt and scene_gt_info .json, rgb, depth, mask and mask_visib.

    A sample is a scene, a view is an image. Millimetres. Objects with the same model have one `obj_id`; models/ has the
    meshes of samples that were made with their models, and models_info.json the boxes of all.
    """
    models = _Models()
    for source in sources:
        scene = f"train/{source.index:06d}"
        cameras: dict[str, Any] = {}
        poses: dict[str, Any] = {}
        infos: dict[str, Any] = {}
        for i, truth in enumerate(_truths(source)):
            depth, scale = _depth_image(truth.depth)
            if source.sample.rig.cameras[i].distortion is not None:
                raise InputError(
                    f"{source.sample.name}: view {i} has lens distortion, which BOP cannot hold"
                )
            cameras[str(i)] = _scene_camera(source, i, scale)
            yield f"{scene}/rgb/{i:06d}.png", source.image(i)
            yield f"{scene}/depth/{i:06d}.png", encode_png(depth)
            for k, instance in enumerate(truth.objects):
                whole = truth.silhouette(instance)
                visible = truth.object_id == instance.object_id
                yield f"{scene}/mask/{i:06d}_{k:06d}.png", _mask_png(whole)
                yield f"{scene}/mask_visib/{i:06d}_{k:06d}.png", _mask_png(visible)
                name = category(truth.object_name(instance), truth.object_names)
                number = models.number_of(instance, name)
                yield from models.mesh(source, instance)
                pose = {"obj_id": number, **_pose_mm(instance.cam_from_object, "m2c")}
                poses.setdefault(str(i), []).append(pose)
                info = _gt_info(instance, int(np.count_nonzero(whole & (depth > 0))))
                infos.setdefault(str(i), []).append(info)
        yield f"{scene}/scene_camera.json", _lines(cameras)
        yield f"{scene}/scene_gt.json", _lines(poses)
        yield f"{scene}/scene_gt_info.json", _lines(infos)
        if source.index == 0:
            yield "camera.json", json.dumps(_camera_json(source)).encode()
    yield "models/models_info.json", models.info()


class _Models:
    """The models of all scenes: objects with the same triangles have one number."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}
        self._facts: dict[int, dict[str, Any]] = {}

    def number_of(self, instance: ObjectTruth, name: str) -> int:
        """The `obj_id` of an object of a category, from 1."""
        number = self._numbers.setdefault(instance.model, len(self._numbers) + 1)
        if number not in self._facts:
            self._facts[number] = {"name": name, **_box_mm(instance.extent)}
        return number

    def mesh(
        self, source: Source, instance: ObjectTruth
    ) -> Iterator[tuple[str, bytes]]:
        """The file of the model's triangles, once, from the first sample that has them."""
        number = self._numbers[instance.model]
        file = f"models/{instance.model}.ply"
        if "diameter" in self._facts[number] or not source.sample.has(file):
            return
        vertices, faces = read_ply(source.sample.path(file))
        self._facts[number]["diameter"] = _diameter(vertices) * _MM
        mesh = encode_ply(vertices * _MM, faces, text=True)
        yield f"models/obj_{number:06d}.ply", mesh

    def info(self) -> bytes:
        """models_info.json."""
        return _lines({str(number): facts for number, facts in self._facts.items()})


def _mask_png(mask: NDArray[np.bool_]) -> bytes:
    return encode_png(np.where(mask, np.uint8(255), np.uint8(0)))


def _truths(source: Source) -> Iterator[Truth]:
    """The truth of each view, with the objects to export."""
    sample = source.sample
    for i in range(len(sample.rig)):
        truth = sample.truth(i)
        if not truth.objects and truth.hit.any():
            raise InputError(
                f"{sample.name}: has no poses of objects; make the sample again with this version"
            )
        chosen = [
            instance
            for instance in truth.objects
            if source.exports(truth.object_name(instance), truth.object_names)
        ]
        yield replace(truth, objects=tuple(chosen))


def _depth_image(depth: Float) -> tuple[NDArray[np.uint16], float]:
    """16-bit depth, 0 where nothing was hit, and its unit in millimetres."""
    hit = np.isfinite(depth)
    scale, most = _DEPTH_SCALE, depth[hit].max(initial=0.0) * _MM
    while most > 65535 * scale:
        scale *= 10
    counts = np.maximum(np.round(np.where(hit, depth, 0.0) * _MM / scale), 1)
    return np.where(hit, counts, 0).astype(np.uint16), scale


def _scene_camera(source: Source, i: int, depth_scale: float) -> dict[str, Any]:
    rig = source.sample.rig
    pose = _pose_mm(inverse(rig.world_from_cams[i]), "w2c")
    return {
        "cam_K": rig.cameras[i].K.ravel().tolist(),
        "depth_scale": depth_scale,
        **pose,
    }


def _camera_json(source: Source) -> dict[str, Any]:
    camera = source.sample.rig.cameras[0]
    names = ("width", "height", "fx", "fy", "cx", "cy")
    return {name: getattr(camera, name) for name in names} | {
        "depth_scale": _DEPTH_SCALE
    }


def _pose_mm(pose: Float, name: str) -> dict[str, list[float]]:
    return {
        f"cam_R_{name}": pose[:3, :3].ravel().tolist(),
        f"cam_t_{name}": (pose[:3, 3] * _MM).tolist(),
    }


def _box_mm(extent: Float) -> dict[str, float]:
    low, size = extent[0] * _MM, np.ptp(extent, axis=0) * _MM
    return {f"min_{axis}": low[k] for k, axis in enumerate("xyz")} | {
        f"size_{axis}": size[k] for k, axis in enumerate("xyz")
    }


def _gt_info(instance: ObjectTruth, valid: int) -> dict[str, Any]:
    """The toolkit's boxes end at the last pixel, and are -1 for hidden objects."""
    boxes = {"bbox_obj": instance.box, "bbox_visib": instance.visible_box}
    seen = instance.visible_pixel_count > 0
    return {
        **{
            name: [box[0], box[1], box[2] - 1, box[3] - 1] if seen else [-1] * 4
            for name, box in boxes.items()
        },
        "px_count_all": instance.pixel_count,
        "px_count_valid": valid,
        "px_count_visib": instance.visible_pixel_count,
        "visib_fract": instance.visible_fraction,
    }


def _diameter(vertices: Float) -> float:
    """The largest distance between two vertices, which are on the convex hull."""
    if len(vertices) > 4:
        # QJ: flat sets have a hull too.
        hull = ConvexHull(vertices, qhull_options="QJ")
        vertices = vertices[hull.vertices]
    # In blocks, as the matrix of all distances may not fit into memory.
    blocks = (vertices[i : i + 512] for i in range(0, len(vertices), 512))
    return float(max(cdist(block, vertices).max() for block in blocks))


def _lines(content: dict[str, Any]) -> bytes:
    """A JSON object with one key a line, as the toolkit writes them."""
    entries = ",\n".join(
        f"  {json.dumps(key)}: {json.dumps(value, allow_nan=False)}"
        for key, value in content.items()
    )
    return f"{{\n{entries}\n}}\n".encode()
