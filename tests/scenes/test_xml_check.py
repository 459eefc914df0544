"""A Mitsuba file that could run code or read elsewhere is refused before Mitsuba sees it."""

import re
from pathlib import Path

import pytest
from PIL import Image

from twinlens.errors import InputError
from twinlens.scenes.xml_file import checked_xml

HARMLESS = """<scene version="3.0.0">
  <default name="spp" value="16"/>
  <integrator type="path"><integer name="max_depth" value="6"/></integrator>
  <sensor type="perspective">
    <float name="fov" value="45"/>
    <transform name="to_world"><lookat origin="0, -3, 1" target="0, 0, 0.5" up="0, 0, 1"/></transform>
    <sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>
    <film type="hdrfilm"><integer name="width" value="64"/><rfilter type="box"/></film>
  </sensor>
  <bsdf type="twosided" id="paint"><bsdf type="diffuse">
    <texture type="bitmap" name="reflectance"><string name="filename" value="deep/t.png"/></texture>
  </bsdf></bsdf>
  <bsdf type="roughconductor" id="gold"><string name="material" value="Au"/></bsdf>
  <shape type="sphere"><ref id="paint"/><point name="center" x="0" y="0" z="0.5"/></shape>
  <emitter type="constant"><spectrum name="radiance" value="400:1.0, 700:1.5"/></emitter>
  <!-- more -->
</scene>"""


def check(folder: Path, text: str) -> list[Path]:
    (folder / "deep").mkdir(exist_ok=True)
    Image.new("L", (1, 1)).save(folder / "deep" / "t.png")
    path = folder / "s.xml"
    path.write_text(text)
    return checked_xml(path)[1]


def test_a_harmless_file_passes_and_its_files_are_listed(tmp_path: Path) -> None:
    assert check(tmp_path, HARMLESS) == [(tmp_path / "deep" / "t.png").resolve()]


EVIL = [
    ('<shape type="../../evil"/>', "unknown shape type '../../evil'"),
    ('<shape type="/tmp/evil"/>', "unknown shape type"),
    ('<shape type="$kind"/>', "type='$kind': write the type itself"),
    ("<shape/>", "unknown shape type"),
    ('<bsdf type="difuse"/>', "unknown bsdf type 'difuse'; did you mean 'diffuse'"),
    (
        '<bsdf type="diffuse"><texture type="../x"/></bsdf>',
        "scene.bsdf.texture: unknown texture type",
    ),
    ('<include filename="other.xml"/>', "unknown element 'include'"),
    ('<path value="/tmp"/>', "unknown element 'path'"),
    ('<plugin type="x"/>', "unknown element 'plugin'"),
    (
        '<shape type="obj"><string name="filename" value="../m.obj"/></shape>',
        "leads outside the folder '",
    ),
    (
        '<shape type="obj"><string name="filename" value="/etc/passwd"/></shape>',
        "must be a file name relative",
    ),
    (
        '<shape type="obj"><string name="filename" value="$f"/></shape>',
        "$ parameters may replace numbers only",
    ),
    (
        '<string name="$n" value="secret"/>',
        "scene.string: name='$n': write the name itself",
    ),
    ('<bsdf type="diffuse" id="$n"/>', "write the id itself"),
    ('<bsdf type="diffuse"><ref id="$n"/></bsdf>', "write the id itself"),
    ('<float name="a$n" value="1"/>', "write the name itself"),
    ('<default name="m" value="$n"/>', "write the value itself"),
    (
        '<emitter type="constant"><spectrum name="radiance" value="$n"/></emitter>',
        "write the value itself",
    ),
    (
        '<emitter type="constant"><spectrum name="radiance" filename="$n"/></emitter>',
        "write the filename itself",
    ),
    (
        '<shape type="obj"><string name="filename" value="missing.obj"/></shape>',
        "no file 'missing.obj'",
    ),
    ('<default name="f" value="../../x"/>', "looks like a file name"),
    (
        '<bsdf type="conductor"><string name="material" value="../../x"/></bsdf>',
        "unknown conductor",
    ),
    (
        '<bsdf type="conductor"><string name="eta" value="../../x.spd"/></bsdf>',
        "looks like a file name",
    ),
    (
        '<emitter type="constant"><spectrum name="radiance" filename="../x.spd"/></emitter>',
        "leads outside",
    ),
    (
        '<emitter type="constant"><spectrum name="radiance" value="x.spd"/></emitter>',
        "write the spectrum's numbers",
    ),
    ('<float type="x" name="a" value="1"/>', "<float> takes no type"),
    ('<spectrum type="../x" name="a"/>', "unknown spectrum type"),
]


@pytest.mark.parametrize(("element", "message"), EVIL, ids=[e[0][:45] for e in EVIL])
def test_harmful_elements_are_errors_with_their_place(
    tmp_path: Path, element: str, message: str
) -> None:
    with pytest.raises(InputError) as caught:
        check(tmp_path, HARMLESS.replace("<!-- more -->", element))
    assert str(caught.value).startswith(f"{tmp_path / 's.xml'}: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_link_out_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "l.ply").symlink_to("/etc/hostname")
    with pytest.raises(InputError, match="leads outside"):
        check(
            tmp_path,
            '<scene><shape type="ply"><string name="filename" value="l.ply"/></shape></scene>',
        )


@pytest.mark.parametrize(
    "sly",
    [
        '<default name="n" value="filename"/><shape type="ply"><string name="$n" value="secret"/></shape>',
        '<default name="n" value="name"/><shape type="ply"><string name="file$n" value="secret"/></shape>',
        '<shape type="ply"><string name="filename" value="secret"/></shape>',
        '<bsdf type="measured"><string name="material_name" value="secret"/></bsdf>',
        '<default name="n" value="secret"/>',
    ],
)
def test_every_name_of_a_link_out_of_the_folder_is_an_error(
    tmp_path: Path, sly: str
) -> None:
    (tmp_path / "secret").symlink_to("/etc/hostname")
    with pytest.raises(
        InputError, match=r"leads outside|\$ parameters may replace numbers only"
    ):
        check(tmp_path, f"<scene>{sly}</scene>")


def test_an_environment_map_must_be_the_picture_it_is_named(tmp_path: Path) -> None:
    (tmp_path / "sky.png").write_bytes(b"x")
    for name, says in (
        ("sky.png", "cannot be read as a .png picture"),
        ("deep/t.png", "2x3 pixels or more"),
    ):
        with pytest.raises(InputError, match=re.escape(says)):
            check(
                tmp_path,
                f'<scene><emitter type="envmap"><string name="filename" value="{name}"/></emitter></scene>',
            )


def test_a_dollar_in_the_root_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="scene: version="):
        check(tmp_path, '<scene version="$v"/>')


@pytest.mark.parametrize(
    "number",
    [
        '<float name="a" value="$n"/>',
        '<point name="a" x="$n" y="0" z="$n"/>',
        '<rgb name="a" value="$n, $n, 0"/>',
        '<transform name="to_world"><rotate z="1" angle="$n"/><lookat origin="$n, 0, 0" target="0, 1, 0"/></transform>',
    ],
)
def test_numbers_may_come_from_parameters(tmp_path: Path, number: str) -> None:
    assert (
        check(tmp_path, f'<scene><default name="n" value="3"/>{number}</scene>') == []
    )


def test_files_are_looked_for_where_mitsuba_does_when_the_scene_is_a_link(
    tmp_path: Path,
) -> None:
    """In the folder of the linked file, not of the link."""
    home, here = tmp_path / "home", tmp_path / "here"
    home.mkdir()
    here.mkdir()
    (home / "s.xml").write_text(
        '<scene><shape type="ply"><string name="filename" value="m.ply"/></shape></scene>'
    )
    (home / "m.ply").symlink_to("/etc/hostname")
    (here / "s.xml").symlink_to(home / "s.xml")
    (here / "m.ply").write_text("harmless")
    with pytest.raises(InputError, match="leads outside"):
        checked_xml(here / "s.xml")


@pytest.mark.parametrize(
    "prologue",
    [
        '<!DOCTYPE scene [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;&a;">]>',
        '<!DOCTYPE scene SYSTEM "file:///etc/passwd">',
        '<!DOCTYPE scene [<!ENTITY % p SYSTEM "file:///etc/passwd"> %p;]>',
    ],
)
def test_document_types_and_entities_are_refused(tmp_path: Path, prologue: str) -> None:
    with pytest.raises(InputError, match=r"line 1: a scene needs no <!DOCTYPE>"):
        check(tmp_path, prologue + "<scene/>")


@pytest.mark.parametrize(
    "text",
    ["", "<scene>", "<scene></shape>", "&x;", "<scene a=1/>", "<notscene/>", "\x00"],
)
def test_broken_xml_is_one_line(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match=r"s\.xml: ") as caught:
        check(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_endless_nesting_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nested more than"):
        check(
            tmp_path,
            "<scene>" + "<transform>" * 3000 + "</transform>" * 3000 + "</scene>",
        )


def test_namespaces_are_errors(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        check(tmp_path, '<scene xmlns:x="y"><x:shape type="../e"/></scene>')


@pytest.mark.parametrize(
    ("name", "data", "says"),
    [
        ("t.png", b"not a picture", "cannot be read"),
        ("t.txt", b"text", "pictures may be"),
        ("wide.hdr", b"", "pixels"),
    ],
)
def test_a_texture_is_a_whole_picture_of_a_known_kind_and_a_sensible_size(
    tmp_path, name, data, says
):
    wide = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 99999 +X 99999\n"
    (tmp_path / name).write_bytes(data or wide)
    scene = tmp_path / "s.xml"
    scene.write_text(
        f'<scene><texture type="bitmap"><string name="filename" value="{name}"/></texture></scene>'
    )
    with pytest.raises(InputError, match=says):
        checked_xml(scene)
