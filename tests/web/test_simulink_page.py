"""A Simulink model on the Diagram page: dropped, looked at, imported into the editor."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.lab.served import COMMAND, Served, served
from tests.slx.files import slx, written
from tests.web.conftest import OpenPage, axe, readable
from tests.web.test_diagram_page import COVERED

pytestmark = pytest.mark.slow

DROP = """([sheet, files]) => {
  const given = new DataTransfer();
  for (const [name, content] of files) {
    const bytes = Uint8Array.from(atob(content), (c) => c.charCodeAt(0));
    given.items.add(new File([bytes], name));
  }
  for (const kind of ["dragover", "drop"])
    document.querySelector(sheet).dispatchEvent(
      new DragEvent(kind, { dataTransfer: given, bubbles: true, cancelable: true }));
}"""
OPAQUE = """
<Block BlockType="Inport" Name="u" SID="1"><P Name="OutDataTypeStr">double</P></Block>
<Block BlockType="M-S-Function" Name="secret" SID="2"/>
<Block BlockType="Outport" Name="y" SID="3"/>
<Line><P Name="Src">1#out:1</P><P Name="Dst">2#in:1</P></Line>
<Line><P Name="Src">2#out:1</P><P Name="Dst">3#in:1</P></Line>
"""


CLOSE = """
<Block BlockType="Inport" Name="u" SID="1"><P Name="Position">[10, 108, 40, 122]</P></Block>
<Block BlockType="Gain" Name="a" SID="2"><P Name="Position">[70, 100, 100, 130]</P></Block>
<Block BlockType="Gain" Name="b" SID="3"><P Name="Position">[115, 100, 145, 130]</P></Block>
<Block BlockType="Outport" Name="y" SID="4"><P Name="Position">[175, 108, 205, 122]</P></Block>
<Line><P Name="Src">1#out:1</P><P Name="Dst">2#in:1</P></Line>
<Line><P Name="Src">2#out:1</P><P Name="Dst">3#in:1</P></Line>
<Line><P Name="Src">3#out:1</P><P Name="Dst">4#in:1</P></Line>
"""
"""Two gains of Simulink's size, side by side."""


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, built_page: Path) -> Iterator[Served]:
    assert built_page.is_dir()
    with served(tmp_path_factory.mktemp("data"), token=COMMAND, command_token=COMMAND) as there:
        yield there


def drop(page: Page, *files: Path) -> None:
    """Drop files on the sheet of the Diagram page."""
    expect(page.locator(".sheet")).to_be_visible()
    sent = [(file.name, base64.b64encode(file.read_bytes()).decode()) for file in files]
    page.evaluate(DROP, [".sheet", sent])


def test_a_dropped_model_is_looked_at_and_imported(server: Served, open_page: OpenPage, tmp_path: Path) -> None:
    page = open_page(f"http://{server.host}/?token={COMMAND}#/diagram?starter=pid-attitude")
    drop(page, written("split", tmp_path))
    dialog = page.get_by_role("dialog", name="Simulink model split.slx")
    picture = dialog.get_by_role("img")
    expect(picture).to_be_visible()
    assert picture.evaluate("image => image.naturalWidth") > 300
    expect(dialog.get_by_role("row", name="refused P gain")).to_contain_text("g")
    expect(dialog.get_by_text("It cannot be imported as it is")).to_be_visible()
    expect(dialog.get_by_role("button", name="Import the whole model")).to_be_disabled()
    workspace = tmp_path / "gains.m"
    workspace.write_text("g.ki = 0.25; M_MAX = 0.2;")
    dialog.get_by_label("Its workspace").set_input_files(workspace)
    expect(dialog.get_by_role("button", name="Import the whole model")).to_be_enabled()
    readable(page, "simulink")
    dialog.get_by_role("button", name="limits//all").click()
    expect(dialog.get_by_alt_text("limits//all")).to_be_visible()
    dialog.get_by_role("button", name="Import this subsystem").click()
    expect(dialog).to_be_hidden()
    expect(page.locator(".svelte-flow__node[data-id='p:Saturation']")).to_be_visible()
    expect(page.get_by_role("heading", level=1)).to_contain_text("Diagram")


def test_imported_blocks_do_not_cover_each_other(server: Served, open_page: OpenPage, tmp_path: Path) -> None:
    page = open_page(f"http://{server.host}/?token={COMMAND}#/diagram?starter=pid-attitude")
    body = f"<ModelInformation><Model><System>{CLOSE}</System></Model></ModelInformation>"
    drop(page, slx({"simulink/blockdiagram.xml": body}, tmp_path / "close.slx"))
    page.get_by_role("button", name="Import the whole model").click()
    expect(page.locator(".svelte-flow__node[data-id='p:b']")).to_be_visible()
    assert page.evaluate(COVERED) == []


def test_unsaved_changes_are_not_lost_by_an_import(server: Served, open_page: OpenPage, tmp_path: Path) -> None:
    page = open_page(f"http://{server.host}/?token={COMMAND}#/diagram?starter=pid-attitude")
    sheet = page.locator(".sheet")
    sheet.press("Control+a")
    sheet.press("Delete")
    workspace = tmp_path / "gains.m"
    workspace.write_text("g.ki = 0.25; M_MAX = 0.2;")
    drop(page, written("single", tmp_path), workspace)
    page.get_by_role("button", name="Import the whole model").click()
    page.get_by_role("button", name="Stay here").click()
    expect(page.locator(".svelte-flow__node[data-id='p:P_gain']")).to_have_count(0)
    page.get_by_role("button", name="Import the whole model").click()  # it is still there
    page.get_by_role("button", name="Save pid_attitude first").click()
    page.get_by_role("button", name="Save", exact=True).last.click()
    expect(page.get_by_role("dialog")).to_have_count(0)
    expect(page.locator(".svelte-flow__node[data-id='p:P_gain']")).to_be_visible()
    assert any("pid_attitude" in file.name for file in server.folder.rglob("*.json"))


def test_a_refused_block_names_itself_and_other_files_are_refused(
    server: Served, open_page: OpenPage, tmp_path: Path
) -> None:
    page = open_page(f"http://{server.host}/?token={COMMAND}#/diagram?starter=pid-attitude", expects=("422",))
    body = f"<ModelInformation><Model><System>{OPAQUE}</System></Model></ModelInformation>"
    drop(page, slx({"simulink/blockdiagram.xml": body}, tmp_path / "opaque.slx"))
    dialog = page.get_by_role("dialog", name="Simulink model opaque.slx")
    expect(dialog.get_by_role("row", name="secret")).to_contain_text("refused")
    expect(dialog.get_by_text("the model says no period: 0.004 s is taken")).to_be_visible()
    assert axe(page, "dialog") == []
    dialog.get_by_role("button", name="Close").last.click()
    broken = tmp_path / "broken.slx"
    broken.write_bytes(b"PK not a model")
    drop(page, broken)
    expect(page.get_by_role("dialog").get_by_role("alert")).to_contain_text("broken.slx")
    expect(page.get_by_role("dialog").get_by_role("alert")).not_to_contain_text(str(server.folder))
    page.get_by_role("button", name="Close").last.click()
    text = tmp_path / "notes.txt"
    text.write_text("no diagram")
    drop(page, text)
    expect(page.get_by_text("notes.txt is not a diagram")).to_be_visible()
