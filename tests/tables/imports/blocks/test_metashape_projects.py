"""Metashape: projects in parts, labels that repeat, and which markers are measured."""

import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.helpers import refused
from tests.small_block import SmallBlock
from tests.tables.imports.blocks.reading import refusal, rows
from unbend.tables.imports.blocks import block_reader, read_block_images, read_camera


def zipped(path, **files):
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            archive.writestr(name.replace("__", "."), content)


def write_psx(folder, block):
    """The same chunk in the parts of a project, with two tie points of one image beside it."""
    block.write_metashape(folder / "whole.xml", reference="EPSG:4326")
    text = (folder / "whole.xml").read_text()
    frame = re.search(r'<frame id="0">(.*)</frame>', text)[1]
    chunk = re.search(r"<chunk .*</chunk>", text)[0].replace(
        f'<frame id="0">{frame}</frame>', '<frame id="0" path="0/frame.zip"/>'
    )
    chunk = chunk.replace("<chunk ", '<chunk version="1.2.0" ', 1)
    files = folder / "survey.files"
    zipped(
        files / "project.zip",
        doc__xml='<document version="1.2.0"><chunks next_id="1" active_id="0">'
        '<chunk id="0" path="0/chunk.zip"/></chunks></document>',
    )
    zipped(files / "0" / "chunk.zip", doc__xml=chunk)
    frame += '<point_cloud id="0" path="point_cloud/point_cloud.zip"/>'
    zipped(files / "0/0/frame.zip", doc__xml=f'<frame version="1.2.0">{frame}</frame>')
    ties = np.array(
        [(10.5, 20.5, 1.0, 3), (30.25, 40.75, 1.0, 4)],
        [("x", "<f4"), ("y", "<f4"), ("size", "<f4"), ("id", "<i4")],
    )
    head = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty float x\n"
        "property float y\nproperty float size\nproperty int id\nend_header\n"
    )
    zipped(
        files / "0/0/point_cloud/point_cloud.zip",
        doc__xml='<point_cloud version="1.2.0"><projections camera_id="0" path="p0.ply"/>'
        "</point_cloud>",
        p0__ply=head.encode() + ties.tobytes(),
    )
    path = folder / "survey.psx"
    path.write_text('<document version="1.2.0" path="{projectname}.files/project.zip"/>')
    return path


def test_a_project_of_metashape_is_its_parts(tmp_path):
    block = SmallBlock.make()
    path = write_psx(tmp_path, block)

    images = read_block_images(path, "metashape")
    image_points = rows(path, "metashape")

    whole = read_block_images(tmp_path / "whole.xml", "metashape")
    assert_array_equal(images.position, whole.position)
    assert images.frame == "ecef"
    ties = image_points[image_points["point"].str.startswith("tie:")]
    assert ties[["image", "point", "x_px", "y_px"]].to_numpy().tolist() == [
        ["IMG_0001.JPG", "tie:3", 10.5, 20.5],
        ["IMG_0001.JPG", "tie:4", 30.25, 40.75],
    ]
    assert len(image_points) == 2 + len(block.observations)
    names = [file.name for file in block_reader("metashape").block_files(path)]
    assert names == ["survey.psx", "project.zip", "chunk.zip", "frame.zip", "point_cloud.zip"]
    assert read_camera(path, None, "c").fx_px == 5000.0


def test_a_project_without_its_folder_names_the_way_out(tmp_path):
    path = write_psx(tmp_path, SmallBlock.make())
    (tmp_path / "survey.files/0/0/frame.zip").unlink()
    assert "frame.zip" in refusal(path, "metashape")
    (tmp_path / "survey.files").rename(tmp_path / "elsewhere.files")
    with refused("INPUT-MISSING", says=".psz"):
        block_reader("metashape").block_files(path)


def write_two_flights(path, block):
    """A document of twelve images, of which the last six are called as the first; its text."""
    block.write_metashape(path, reference="EPSG:4326")
    text = path.read_text()
    text = text.replace('label="IMG_0007.JPG"', 'label="IMG_0001.JPG"')
    text = text.replace('label="IMG_0008.JPG"', 'label="IMG_0002.JPG"')
    path.write_text(text)
    return text


def in_groups(text):
    cameras = re.findall(r"<camera id.*?</camera>", text)
    for label, part in (("one", cameras[:6]), ("two", cameras[6:])):
        together = "".join(part)
        text = text.replace(together, f'<group id="1" label="{label}">{together}</group>')
    return text


def with_paths(text):
    photos = ""
    for number in range(12):
        folder = "one" if number < 6 else "two"
        photo = f'<photo path="/a/{folder}/x.JPG"/>'
        photos += f'<camera camera_id="{number}">{photo}</camera>'
    return text.replace('<frame id="0">', f'<frame id="0"><cameras>{photos}</cameras>')


@pytest.mark.parametrize("with_folders", [in_groups, with_paths])
def test_labels_that_repeat_have_their_folders(with_folders):
    block = SmallBlock.make()
    path = Path("s.xml")
    text = write_two_flights(path, block)
    path.write_text(with_folders(text))

    names = read_block_images(path, "metashape").image.tolist()
    assert names[:3] == ["one/IMG_0001.JPG", "one/IMG_0002.JPG", "IMG_0003.JPG"]
    assert names[6:8] == ["two/IMG_0001.JPG", "two/IMG_0002.JPG"]
    image_points = rows(path, "metashape")
    assert set(image_points["image"]) <= set(names)
    expected = block.observations[block.observations["image"] == "IMG_0007.JPG"]
    of_image = image_points[image_points["image"] == "two/IMG_0001.JPG"]
    assert sorted(of_image["x_px"]) == sorted(expected["x_px"])


def test_labels_that_repeat_without_folders_are_refused():
    path = Path("s.xml")
    write_two_flights(path, SmallBlock.make())
    assert "ORIENTATION-REPEATED" in refusal(path, "metashape")


def test_what_a_marker_is_not_valid_for_is_left_out():
    """Pinned by hand or found by the program are both measured."""
    block = SmallBlock.make()
    path = Path("s.xml")
    block.write_metashape(path, reference="EPSG:4326")
    text = path.read_text().replace('pinned="true"', 'pinned="false"', 5)
    path.write_text(text.replace('pinned="true"', 'valid="false" pinned="true"', 1))
    assert len(rows(path, "metashape")) == len(block.observations) - 1
