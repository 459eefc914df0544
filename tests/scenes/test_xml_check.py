"""A Mitsuba file that could run code or read elsewhere is refused before Mitsuba sees it."""

import re

import numpy as np
import pytest
import trimesh
from PIL import Image

from twinlens.errors import InputError
from twinlens.rendering import backends
from twinlens.scenes import load_scene, xml_file
from twinlens.scenes.scene import SceneWarning
from twinlens.scenes.xml_file import checked_xml, resolved_xml

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
  <float name="a" value="$spp"/>
  <point name="a" x="$spp" y="0" z="$spp"/>
  <rgb name="a" value="$spp, $spp, 0"/>
  <transform name="to_world"><rotate z="1" angle="$spp"/><lookat origin="$spp, 0, 0" target="0, 1, 0"/></transform>
</scene>"""


def check(folder, text):
    (folder / "deep").mkdir(exist_ok=True)
    Image.new("L", (1, 1)).save(folder / "deep" / "t.png")
    path = folder / "s.xml"
    path.write_text(text)
    return checked_xml(path)[1]


def test_a_harmless_file_passes_and_its_files_are_listed(tmp_path):
    assert check(tmp_path, HARMLESS) == [(tmp_path / "deep" / "t.png").resolve()]


LAUGHS = '<default name="p0" value="lol"/>' + "".join(
    f'<default name="p{i + 1}" value="{f"$p{i}" * 10}"/>' for i in range(9)
)
EVIL = {
    '<shape type="../../evil"/>': "unknown shape type '../../evil'",
    '<shape type="$kind"/>': "type='$kind': no parameter 'kind'; add <default name='kind' value=.../> before",
    '<default name="k" value="../../evil"/><shape type="$k"/>': "unknown shape type '../../evil'",
    '<default name="a" value="$spp$b"/>': "no parameter 'b'",
    '<default name="a b" value="1"/>': "'a b' is not the name of a parameter",
    "<shape/>": "unknown shape type",
    '<bsdf type="difuse"/>': "unknown bsdf type 'difuse'; did you mean 'diffuse'",
    '<bsdf type="diffuse"><texture type="../x"/></bsdf>': "scene.bsdf.texture: unknown texture type",
    '<include filename="other.xml"/>': "no file 'other.xml'",
    '<include filename="s.xml"/>': "s.xml includes itself",
    '<include filename="../../../../../s.xml"/>': "leads more than 3 levels above the scene file",
    '<include filename="../other.xml"/>': "no file 'other.xml' in the folder",
    '<include filename="deep/../other.xml"/>': "'..' is not allowed; write 'other.xml'",
    '<path value="/tmp"/>': "'/tmp': write the folder relative to the file that names it",
    '<path value="../../../../../.."/>': "leads more than 3 levels above the scene file",
    '<path value="nowhere"/>': "no folder 'nowhere' beside s.xml",
    '<plugin type="x"/>': "unknown element 'plugin'",
    '<shape type="obj"><string name="filename" value="../../../../../m.obj"/></shape>': "leads more than 3 levels",
    '<shape type="obj"><string name="filename" value="/etc/passwd"/></shape>': "must be a file name relative",
    '<shape type="obj"><string name="filename" value="missing.obj"/></shape>': "no file 'missing.obj'",
    '<emitter type="constant"><spectrum name="radiance" filename="../x.spd"/></emitter>': "no file 'x.spd'",
    '<emitter type="constant"><spectrum name="radiance" value="x.spd"/></emitter>': "write the spectrum's numbers",
    '<bsdf type="conductor"><string name="material" value="../../x"/></bsdf>': "unknown conductor",
    '<bsdf type="conductor"><string name="eta" value="../../x.spd"/></bsdf>': "looks like a file name",
    '<float type="x" name="a" value="1"/>': "<float> takes no type",
    '<spectrum type="../x" name="a"/>': "unknown spectrum type",
    '<sub xmlns:x="y"><x:shape type="../e"/></sub>': "unknown element 'sub'",
    # every name that a link out of the folder may get
    '<default name="n" value="filename"/><shape type="ply"><string name="$n" value="secret"/></shape>': "leads outside",
    '<default name="n" value="name"/><shape type="ply"><string name="file$n" value="secret"/></shape>': "leads outside",
    '<shape type="ply"><string name="filename" value="secret"/></shape>': "leads outside",
    '<bsdf type="measured"><string name="material_name" value="secret"/></bsdf>': "leads outside",
    # pictures
    '<texture type="bitmap"><string name="filename" value="t.png"/></texture>': "is not a PNG picture",
    '<texture type="bitmap"><string name="filename" value="t.txt"/></texture>': "pictures may be",
    '<texture type="bitmap"><string name="filename" value="wide.hdr"/></texture>': "pixels",
    '<emitter type="envmap"><string name="filename" value="t.png"/></emitter>': "is not a PNG picture",
    '<emitter type="envmap"><string name="filename" value="deep/t.png"/></emitter>': "2x3 pixels or more",
    '<default name="t" value="wide.hdr"/>'
    '<texture type="bitmap"><string name="filename" value="$t"/></texture>': "pixels",
    '<default name="f" value="filename"/>'
    '<texture type="bitmap"><string name="$f" value="t.png"/></texture>': "is not a PNG picture",
    '<texture type="bitmap"><include filename="name.xml"/></texture>': "is not a PNG picture",
    # expansions that never end
    LAUGHS: "characters",
    '<include filename="wide.xml"/>' * 20: "more than 1000 elements",
    f'<shape type="ply"><string name="filename" value="{"é" * 200}"/></shape>': "no file '",
    "<transform>" * 3000 + "</transform>" * 3000: "nested more than",
}  # fmt: skip


@pytest.mark.parametrize("element", EVIL, ids=[element[:45] for element in EVIL])
def test_harmful_elements_are_errors_with_their_place(tmp_path, monkeypatch, element):
    monkeypatch.setattr(xml_file, "_MOST_ELEMENTS", 1000)
    (tmp_path / "secret").symlink_to("/etc/hostname")
    (tmp_path / "t.png").write_bytes(b"not a picture")
    (tmp_path / "t.txt").write_bytes(b"text")
    (tmp_path / "name.xml").write_text(
        '<scene><string name="filename" value="t.png"/></scene>'
    )
    (tmp_path / "wide.xml").write_text(f"<scene>{'<ref/>' * 60}</scene>")
    wide = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 99999 +X 99999\n"
    (tmp_path / "wide.hdr").write_bytes(wide)
    with pytest.raises(InputError, match=re.escape(EVIL[element])) as caught:
        check(tmp_path, HARMLESS.replace("</scene>", element + "</scene>"))
    assert re.match(rf"{tmp_path}/(s|wide)\.xml: ", str(caught.value))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("levels", [1, 2, 3, 4])
@pytest.mark.parametrize("by_path", [True, False])
def test_files_may_lie_above_the_scene_as_folders_of_path_may(
    tmp_path, levels, by_path
):
    """As in a file of Mitsuba's public test data, ../../serialized/rectangle_normals_uv.serialized."""
    home = tmp_path / "four" / "levels" / "down" / "here"
    home.mkdir(parents=True)
    up = "../" * levels
    (home / up / "m").mkdir(exist_ok=True)
    trimesh.creation.box().export((home / up / "m" / "box.ply").resolve())
    path, name = (up, "m/box.ply") if by_path else (".", f"{up}m/box.ply")
    shape = f'<shape type="ply"><string name="filename" value="{name}"/></shape>'
    text = HARMLESS.replace("</scene>", f'<path value="{path}"/>{shape}</scene>')
    if levels > 3:
        with pytest.raises(InputError, match="leads more than 3 levels above the"):
            check(home, text)
        return
    files = check(home, text)
    assert (home / up / "m" / "box.ply").resolve() in files


def test_files_are_looked_for_where_mitsuba_does_when_the_scene_is_a_link(
    tmp_path,
):
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


NO_DOCTYPE = r"line 1: a scene needs no <!DOCTYPE>"
BROKEN = {
    '<!DOCTYPE scene [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;&a;">]><scene/>': NO_DOCTYPE,
    '<!DOCTYPE scene SYSTEM "file:///etc/passwd"><scene/>': NO_DOCTYPE,
    '<!DOCTYPE scene [<!ENTITY % p SYSTEM "file:///etc/passwd"> %p;]><scene/>': NO_DOCTYPE,
    '<scene version="$v"/>': "scene: version=.*no parameter",
    '<scene xmlns:x="y"><x:shape type="../e"/></scene>': "",
    **dict.fromkeys(("", "<scene>", "<scene></shape>", "&x;", "<scene a=1/>", "<notscene/>", "\x00"), ""),
}  # fmt: skip


@pytest.mark.parametrize("text", BROKEN)
def test_broken_xml_is_refused_in_one_line(tmp_path, text):
    with pytest.raises(InputError, match=rf"s\.xml: .*{BROKEN[text]}") as caught:
        check(tmp_path, text)
    assert "\n" not in str(caught.value)


SPHERE = '<shape type="sphere" id="sphere"><bsdf type="diffuse"><rgb name="reflectance" value="$grey"/></bsdf></shape>'
BALL = (
    '<shape type="ply" id="ball"><string name="filename" value="m/ball.ply"/></shape>'
)


def test_parameters_includes_and_folders_are_resolved_as_by_mitsuba(tmp_path):
    """Mitsuba itself reads the file, and the text that is given to it: the same shapes, sizes and reflectances."""
    mi = backends.mitsuba()
    (tmp_path / "common" / "m").mkdir(parents=True)
    trimesh.creation.icosphere().export(tmp_path / "common" / "m" / "ball.ply")
    home = tmp_path / "scenes" / "one"
    (home / "parts").mkdir(parents=True)
    (home / "parts" / "ball.xml").write_text(
        f'<scene version="3.0.0">{BALL}{SPHERE}</scene>'
    )
    path = home / "s.xml"
    path.write_text(
        '<scene version="3.0.0"><default name="width" value="32"/><default name="grey" value="0.25"/>'
        '<default name="grey" value="0.75"/><path value="../../common"/>'
        '<path value="parts"/><include filename="ball.xml"/>'
        '<sensor type="perspective" id="sensor"><film type="hdrfilm"><integer name="width" value="$width"/>'
        '<string name="file_format" value="openexr"/></film></sensor></scene>'
    )
    root, files = checked_xml(path)
    assert [file.name for file in files] == ["ball.xml", "ball.ply"]
    assert not {"default", "path", "include"} & {item.tag for item in root.iter()}
    theirs, ours = (
        dict(mi.traverse(scene))
        for scene in (
            mi.load_file(str(path), optimize=False),
            mi.load_string(resolved_xml(path), optimize=False),
        )
    )
    names = [key for key in theirs if key.split(".")[0] in ("sphere", "ball", "sensor")]
    assert len(names) > 10
    for name in names:
        resolved, loaded = np.array(ours[name]), np.array(theirs[name])
        if name.endswith("vertex_normals"):
            # Mitsuba sums the normals of a mesh in the order in which its threads come.
            np.testing.assert_allclose(resolved, loaded, rtol=0, atol=1e-6)
        else:
            np.testing.assert_array_equal(resolved, loaded)
    assert np.array(ours["sensor.film.size"]).tolist() == [32, 576]
    assert (np.array(ours["sphere.bsdf.reflectance.value"]) == 0.25).all()


def test_older_names_and_integrators_that_record_more_are_read(tmp_path):
    path = tmp_path / "s.xml"
    path.write_text(
        '<scene version="0.5.0"><integrator type="moment"><integrator type="path"/></integrator>'
        '<sensor type="perspective"><float name="nearClip" value="2"/><float name="farClip" value="5"/>'
        '<transform name="toWorld"><translate z="1"/></transform></sensor></scene>'
    )
    scene = load_scene(path)
    assert scene.depth_range == (2.0, 5.0)
    assert scene.world_from_left[2, 3] == 1.0
    assert 'integrator type="path"' in resolved_xml(path)
    assert "moment" not in resolved_xml(path)


def test_a_principal_point_that_is_not_used_is_said(tmp_path):
    path = tmp_path / "s.xml"
    path.write_text(
        '<scene version="3.0.0"><sensor type="perspective">'
        '<float name="principal_point_offset_x" value="0.25"/></sensor></scene>'
    )
    with pytest.warns(
        SceneWarning, match=r"s\.xml: sensor: not used: principal_point_offset_x"
    ):
        load_scene(path)
