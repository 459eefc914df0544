"""Every field of every lens can be set in a recipe, fixed or drawn."""

import dataclasses
import math
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest
from pydantic import TypeAdapter

from twinlens.camera import (
    Annulus,
    ApertureLens,
    BareAperture,
    Disk,
    MaskAperture,
    Pinhole,
    Polygon,
    ThinLens,
)
from twinlens.camera.lens import DIAMETER
from twinlens.dataset import write_png
from twinlens.errors import InputError
from twinlens.factory import plan, recipe_from_table
from twinlens.factory.lenses import LensTable, ShapeTable, lens_forms, make_lens
from twinlens.schema import StrictModel, read
from twinlens.settings import Setting, Settings

CELLS = [[0.0, 1.0, 0.5], [1.0, 0.25, 0.0]]
LENSES = [
    ({"kind": "pinhole"}, Pinhole()),
    ({"kind": "thin", "aperture_mm": 8, "focus": 1.5}, ThinLens(8e-3, 1.5)),
    ({"kind": "thin", "aperture_mm": 8, "focus": math.inf}, ThinLens(8e-3, math.inf)),
    (
        {"kind": "thin", "aperture_mm": 8, "focus": 2, "shape": {"kind": "annulus", "inner": 0.4}},
        ThinLens(8e-3, 2.0, Annulus(0.4)),
    ),
    (
        {"kind": "hole", "aperture_mm": 0.35, "film_mm": 50, "shape": {"kind": "mask", "cells": CELLS}},
        BareAperture(0.35e-3, 50e-3, MaskAperture(CELLS)),
    ),
    (
        {
            "kind": "hole", "aperture_mm": 2, "film_mm": 40,
            "shape": {"kind": "polygon", "blades": 7, "rotation_deg": 12.5, "roundness": 0.3},
        },
        BareAperture(2e-3, 40e-3, Polygon(7, 12.5, 0.3)),
    ),
    ({"kind": "hole", "aperture_mm": 2, "film_mm": 40, "shape": {"kind": "disk"}}, BareAperture(2e-3, 40e-3, Disk())),
]  # fmt: skip


class Lenses(StrictModel):
    lenses: list[LensTable]


def lens_from_table(table, find=Path):
    return make_lens(
        read(Lenses, {"lenses": [table]}, "recipe.toml").lenses[0], None, find
    )


@pytest.mark.parametrize(("table", "lens"), LENSES)
def test_a_table_is_the_lens(table, lens):
    assert lens_from_table(table) == lens


def test_no_quantity_of_a_lens_or_an_aperture_is_left_out():
    """Each field of each class differs from its default in one of the lenses above, but an error of the focus."""
    reached = set()
    for lens in (lens for _, lens in LENSES):
        for part in (lens, lens.aperture):
            for field in dataclasses.fields(part):
                required = field.default is dataclasses.MISSING
                if required or getattr(part, field.name) != field.default:
                    reached.add((type(part), field.name))
    kinds = (Pinhole, ThinLens, BareAperture, Disk, Polygon, Annulus, MaskAperture)
    fields = {
        (kind, field.name)
        for kind in kinds
        for field in dataclasses.fields(kind)
        if field.init
    }
    assert reached & fields == fields - {(ThinLens, "defocus")}
    tables = TypeAdapter(ShapeTable).json_schema()["discriminator"]["mapping"]
    assert set(tables) == {
        shape.name for shape in (Disk, Polygon, Annulus, MaskAperture)
    }


def test_every_quantity_may_be_drawn(tmp_path):
    (tmp_path / "codes").mkdir()
    for k in range(2):
        write_png(
            tmp_path / "codes" / f"{k}.png",
            np.roll(np.eye(4, dtype=np.uint8) * 255, k, axis=1),
        )
    shapes = [
        {
            "kind": "polygon",
            "blades": {"integers": [5, 9]},
            "rotation_deg": {"uniform": [0, 72]},
            "roundness": 0.5,
        },
        {"kind": "annulus", "inner": {"uniform": [0.1, 0.6]}},
        {"kind": "mask", "file": {"sweep": ["codes/0.png", "codes/1.png"]}},
        {"kind": "mask", "cells": [[{"uniform": [0.2, 1]}, 1]]},
        {"choice": [{"kind": "disk"}, {"kind": "mask", "file": "codes/1.png"}]},
    ]
    lens = {
        "kind": "hole",
        "aperture_mm": {"log_uniform": [0.2, 2]},
        "film_mm": {"uniform": [30, 60]},
    }
    written = {
        "seed": 1,
        "count": 30,
        "scenes": ["cards"],
        "lenses": [{**lens, "shape": shape} for shape in shapes],
    }
    recipe = recipe_from_table(written, tmp_path / "recipe.toml")
    drawn = [plan(recipe, index).drawn["lenses"] for index in range(30)]
    for k in range(len(shapes)):
        made = {
            repr(lens_from_table(tables[k], lambda name: tmp_path / name).aperture)
            for tables in drawn
        }
        assert len(made) > 1
    assert tuple(recipe.sources.named) == ("codes/0.png", "codes/1.png")


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ({"kind": "mask"}, r"lenses\[0\].shape: a mask needs exactly one of 'file'"),
        ({"kind": "mask", "file": "none.png"}, r"toml: lenses\[0\]: .*no such file"),
        (
            {"kind": "mask", "file": "blue.png"},
            r"lenses\[0\]: .*blue\.png: is coloured",
        ),
        ({"kind": "mask", "cells": [[0, 0]]}, "mask is black"),
        ({"kind": "disk", "blades": 5}, "unknown key 'blades'"),
    ],
)
def test_invalid_aperture_shapes_are_errors(tmp_path, shape, message):
    write_png(tmp_path / "blue.png", np.full((3, 3, 3), (0, 0, 255), np.uint8))
    lens = {"kind": "thin", "aperture_mm": 8, "shape": shape}
    table = {"seed": 1, "count": 1, "scenes": ["cards"], "lenses": [lens]}
    with pytest.raises(InputError, match=message) as caught:
        recipe_from_table(table, tmp_path / "recipe.toml")
    assert "\n" not in str(caught.value)


@dataclasses.dataclass(frozen=True)
class Soft(Settings, ApertureLens, noun="lens"):
    """A lens that is written by its fields."""

    name = "soft"
    aperture_diameter: Annotated[float, DIAMETER]
    tilt: Annotated[float, Setting("Of the film.", "radians")]
    aberration: Annotated[float, Setting("Spherical.", "1/m^3")] = 0.0


def test_the_form_of_a_lens_has_the_units_and_brackets_what_may_be_left_out():
    form = "soft:aperture_diameter=METRES,tilt=RADIANS[,aberration=VALUE]"
    assert lens_forms([Soft])["soft"] == form
