"""Write the part of docs/own_objects.md: a mount of two painted plates with a brass bush, 60 x 45 x 50 mm, as .glb.

Run: ``python make_part.py mount.glb``. A part from a CAD program takes its place.
"""

import sys
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image, ImageDraw, ImageFont
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

WIDTH, HEIGHT, DEPTH, THICK = 0.060, 0.050, 0.045, 0.005  # metres
BORE = 0.009  # radius of the hole in the upright plate
SECTIONS = 64  # sides of the hole, a multiple of 8: so the outline has the four corners of the plate


def label(name: str) -> Image.Image:
    """A plate's paint, with its name and an arrow towards its upper edge."""
    picture = Image.new("RGB", (480, 400), (225, 130, 20))
    draw = ImageDraw.Draw(picture)
    draw.rectangle((10, 10, 469, 389), outline=(40, 40, 45), width=6)
    draw.text((30, 20), name, fill=(40, 40, 45), font=ImageFont.load_default(90))
    draw.polygon(
        [(420, 25), (455, 85), (432, 85), (432, 150), (408, 150), (408, 85), (385, 85)],
        fill=(40, 40, 45),
    )
    return picture


def plate(width: float, height: float, name: str) -> trimesh.Trimesh:
    """A plate with a hole in its middle, in the plane y = 0, its front towards -y and its upper edge towards +z."""
    angles = 2 * np.pi * np.arange(SECTIONS) / SECTIONS
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    outline = (
        circle / np.abs(circle).max(axis=1, keepdims=True) * [width / 2, height / 2]
    )
    front, front_hole, back_hole, back = (
        np.insert(ring, 1, y, axis=1)
        for ring, y in (
            (outline, -THICK / 2),
            (BORE * circle, -THICK / 2),
            (BORE * circle, THICK / 2),
            (outline, THICK / 2),
        )
    )
    points, u = [], []
    for a, b, mirror in (
        (front, front_hole, 1),
        (front_hole, back_hole, 1),
        (back_hole, back, -1),
        (back, front, 1),
    ):
        quads = np.stack([a, np.roll(a, -1, axis=0), np.roll(b, -1, axis=0), b], axis=1)
        points.append(
            quads.reshape(-1, 3)
        )  # each side has its own corners, and so its own normals and texture
        u.append(
            mirror * points[-1][:, 0] / width + 0.5
        )  # the text reads from behind too
    corners = np.concatenate(points)
    uv = np.stack([np.concatenate(u), corners[:, 2] / height + 0.5], axis=1)
    first = np.arange(0, len(corners), 4)[:, None]
    paint = PBRMaterial(
        name=name, baseColorTexture=label(name), metallicFactor=0.0, roughnessFactor=0.4
    )
    return trimesh.Trimesh(
        corners,
        np.concatenate([first + np.array([0, 1, 2]), first + np.array([0, 2, 3])]),
        visual=TextureVisuals(uv, material=paint),
        process=False,
    )


def mount() -> trimesh.Scene:
    """The part, with z up and its foot on z = 0."""
    turn = trimesh.transformations.rotation_matrix
    upright, foot = plate(WIDTH, HEIGHT - THICK, "FRONT"), plate(WIDTH, DEPTH, "FOOT")
    upright.apply_translation([0, 0, (HEIGHT + THICK) / 2])
    foot.apply_transform(turn(-np.pi / 2, [1, 0, 0]))
    foot.apply_translation([0, (THICK - DEPTH) / 2, THICK / 2])
    bush = trimesh.creation.annulus(
        r_min=0.005, r_max=BORE, height=0.014, sections=SECTIONS
    )
    bush.apply_transform(turn(np.pi / 2, [1, 0, 0]))
    bush.apply_translation([0, 0, (HEIGHT + THICK) / 2])
    bush.visual = TextureVisuals(
        material=PBRMaterial(
            name="brass",
            baseColorFactor=[0.91, 0.78, 0.42, 1.0],
            metallicFactor=1.0,
            roughnessFactor=0.3,
        )
    )
    return trimesh.Scene({"upright": upright, "foot": foot, "bush": bush})


def main(path: str) -> None:
    scene = mount()
    scene.apply_transform(
        trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0])
    )  # glTF's y axis points up
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    scene.export(path)


if __name__ == "__main__":
    main(*sys.argv[1:2] or ["mount.glb"])
