"""A Mitsuba file that could run code or read elsewhere is refused before Mitsuba sees it."""

from pathlib import Path

import pytest

from twinlens.errors import InputError
from twinlens.scenes.xml_check import checked_xml

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
    (folder / "deep" / "t.png").write_bytes(b"x")
    path = folder / "s.xml"
    path.write_text(text)
    return checked_xml(path)[1]


def test_a_harmless_file_passes_and_its_files_are_listed(tmp_path: Path) -> None:
    assert check(tmp_path, HARMLESS) == [(tmp_path / "deep" / "t.png").resolve()]


EVIL = [
    ('<shape type="../../evil"/>', "unknown shape type '../../evil'"),
    ('<shape type="/tmp/evil"/>', "unknown shape type"),
    ('<shape type="$kind"/>', "unknown shape type"),
    ("<shape/>", "unknown shape type"),
    ('<bsdf type="difuse"/>', "unknown bsdf type 'difuse'; did you mean 'diffuse'"),
    ('<bsdf type="diffuse"><texture type="../x"/></bsdf>', "scene.bsdf.texture: unknown texture type"),
    ('<include filename="other.xml"/>', "unknown element 'include'"),
    ('<path value="/tmp"/>', "unknown element 'path'"),
    ('<plugin type="x"/>', "unknown element 'plugin'"),
    ('<shape type="obj"><string name="filename" value="../m.obj"/></shape>', "leads outside the scene's folder"),
    ('<shape type="obj"><string name="filename" value="/etc/passwd"/></shape>', "must be a file name relative"),
    ('<shape type="obj"><string name="filename" value="$f"/></shape>', "cannot be checked through $ parameters"),
    ('<shape type="obj"><string name="filename" value="missing.obj"/></shape>', "no file 'missing.obj'"),
    ('<default name="f" value="../../x"/>', "looks like a file's name"),
    ('<bsdf type="conductor"><string name="material" value="../../x"/></bsdf>', "unknown conductor"),
    ('<bsdf type="conductor"><string name="eta" value="../../x.spd"/></bsdf>', "looks like a file's name"),
    ('<emitter type="constant"><spectrum name="radiance" filename="../x.spd"/></emitter>', "leads outside"),
    ('<emitter type="constant"><spectrum name="radiance" value="x.spd"/></emitter>', "write the spectrum's numbers"),
    ('<float type="x" name="a" value="1"/>', "<float> takes no type"),
    ('<spectrum type="../x" name="a"/>', "unknown spectrum type"),
]


@pytest.mark.parametrize(("element", "message"), EVIL, ids=[e[0][:45] for e in EVIL])
def test_what_could_do_harm_is_refused_with_its_place(tmp_path: Path, element: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        check(tmp_path, HARMLESS.replace("<!-- more -->", element))
    assert str(caught.value).startswith(f"{tmp_path / 's.xml'}: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_link_out_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "l.ply").symlink_to("/etc/hostname")
    with pytest.raises(InputError, match="leads outside"):
        check(tmp_path, '<scene><shape type="ply"><string name="filename" value="l.ply"/></shape></scene>')


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


@pytest.mark.parametrize("text", ["", "<scene>", "<scene></shape>", "&x;", "<scene a=1/>", "<notscene/>", "\x00"])
def test_broken_xml_is_one_line(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match=r"s\.xml: ") as caught:
        check(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_endless_nesting_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nested more than"):
        check(tmp_path, "<scene>" + "<transform>" * 3000 + "</transform>" * 3000 + "</scene>")


def test_namespaces_and_unknown_encodings_do_not_slip_through(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        check(tmp_path, '<scene xmlns:x="y"><x:shape type="../e"/></scene>')
