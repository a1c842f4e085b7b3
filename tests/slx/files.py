"""One small model as a file in each layout that Simulink has had: what a test writes, and reads again."""

import io
import zipfile
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

BLOCKS = """
<Block BlockType="Inport" Name="error" SID="1"><P Name="Position">[20, 40, 50, 54]</P></Block>
<Block BlockType="Gain" Name="P&#xA;gain" SID="2"><P Name="Position">[100, 30, 140, 64]</P><P Name="Gain">kp/2 + g.ki</P></Block>
<Block BlockType="SubSystem" Name="limits/all" SID="3"><P Name="Ports">[1, 1]</P><P Name="Position">[200, 30, 260, 64]</P>{inner}</Block>
<Block BlockType="Outport" Name="M" SID="4"><P Name="Position">[320, 40, 350, 54]</P></Block>
<Line><P Name="Name">e</P><P Name="Src">1#out:1</P><P Name="Points">[20, 0]</P>
<Branch><P Name="Dst">2#in:1</P></Branch><Branch><P Name="Points">[0, 60; 60, 0]</P></Branch></Line>
<Line><P Name="Src">2#out:1</P><P Name="Dst">3#in:1</P></Line>
<Line><P Name="Src">3#out:1</P><P Name="Dst">4#in:1</P></Line>
"""  # noqa: E501
INNER = """
<Block BlockType="Inport" Name="in" SID="5"/>
<Block BlockType="Saturate" Name="Saturation" SID="3::6"><P Name="UpperLimit">M_MAX</P><P Name="LowerLimit">-M_MAX</P></Block>
<Block BlockType="Outport" Name="out" SID="7"/>
<Line><P Name="Src">5#out:1</P><P Name="Dst">3::6#in:1</P></Line>
<Line><P Name="Src">3::6#out:1</P><P Name="Dst">7#in:1</P></Line>
"""  # noqa: E501
SETTINGS = '<P Name="SolverName">ode4</P><P Name="FixedStep">Ts</P><P Name="StopTime">10</P>'
CALLBACK = '<P Name="InitFcn">kp = 2; Ts = 0.004;</P>'
CORE = (
    '<cp:coreProperties xmlns:cp="x"><cp:revision>1.7</cp:revision>'
    "<cp:version>{version}</cp:version></cp:coreProperties>"
)
MATLAB_FUNCTION = """<chart id="9"><P Name="name">limits/f</P><Children><state SSID="1"><P Name="labelString">f</P>
<eml><P Name="script">function y = f(u)
y = u;</P></eml></state></Children></chart>"""

# Tabs and blanks stand between key and value.
BRACES = r"""Model {
  Name                          "braces"
  Version                  7.8
  ComputedModelVersion          "1.7"
  InitFcn                  "kp = 2; Ts = "
  "0.004;"
  Array {
    Type                    "Handle"
    Simulink.SolverCC {
      SolverName            "ode4"
      FixedStep                    "Ts"
      StopTime                    "10"
    }
  }
  System {
    Name                    "braces"
    Block {
      BlockType                      Inport
      Name                      "error"
      SID                      "1"
      Position                      [20, 40, 50, 54]
    }
    Block {
      BlockType                      Gain
      Name                      "P\ngain"
      SID                      "2"
      Position                      [100, 30, 140, 64]
      Gain                      "kp/2 + g.ki"
    }
    Block {
      BlockType                      SubSystem
      Name                      "limits/all"
      SID                      "3"
      Ports                      [1, 1]
      Position                      [200, 30, 260, 64]
      System {
        Name                        "limits/all"
        Block {
          BlockType                  Inport
          Name                          "in"
          SID                          "5"
        }
        Block {
          BlockType                  Saturate
          Name                          "Saturation"
          SID                          "3::6"
          UpperLimit                  "M_MAX"
          LowerLimit                  "-M_MAX"
        }
        Block {
          BlockType                  Outport
          Name                          "out"
          SID                          "7"
        }
        Line {
          SrcBlock                  "in"
          SrcPort                  1
          DstBlock                  "Saturation"
          DstPort                  1
        }
        Line {
          SrcBlock                  "Saturation"
          SrcPort                  1
          DstBlock                  "out"
          DstPort                  1
        }
      }
    }
    Block {
      BlockType                      Outport
      Name                      "M"
      SID                      "4"
      Position                      [320, 40, 350, 54]
    }
    Line {
      Name                      "e"
      SrcBlock                      "error"
      SrcPort                      1
      Points                      [20, 0]
      Branch {
        DstBlock                "P\ngain"
        DstPort                        1
      }
      Branch {
        Points                        [0, 60; 60, 0]
      }
    }
    Line {
      SrcBlock                      "P\ngain"
      SrcPort                      1
      DstBlock                      "limits/all"
      DstPort                      1
    }
    Line {
      SrcBlock                      "limits/all"
      SrcPort                      1
      DstBlock                      "M"
      DstPort                      1
    }
  }
}
Stateflow {
  chart {
    id                            2
    name                    "limits/f"
    type                    EML_CHART
  }
  state {
    id                            3
    treeNode                    [2 0 0 0]
    labelString                    "eML_blk_kernel()"
    eml {
      script                      "function y = f(u)\ny = "
      "u;"
    }
  }
}
"""


def parts(layout: str) -> dict[str, str]:
    """Return the parts of the model: `single` (to R2019b), `split` (from R2020a) or `counts` (from R2022b)."""
    if layout == "single":
        body = f"<System>{BLOCKS.format(inner=f'<System>{INNER}</System>')}</System>"
        model = f'<Model><P Name="ComputedModelVersion">1.7</P>{CALLBACK}<Array>{SETTINGS}</Array>{body}</Model>'
        return {
            "simulink/blockdiagram.xml": f'<?xml version="1.0"?><ModelInformation>{model}</ModelInformation>',
            "simulink/stateflow.xml": f"<Stateflow><machine>{MATLAB_FUNCTION}</machine></Stateflow>",
            "metadata/coreProperties.xml": CORE.format(version="8.7"),
        }
    blocks = BLOCKS.format(inner='<System Ref="system_3"/>')
    if layout == "counts":
        blocks = blocks.replace('<P Name="Ports">[1, 1]</P>', '<PortCounts in="1" out="1"/>')
    model = f'<Model>{CALLBACK}<System Ref="system_root"/></Model>'
    return {
        "simulink/blockdiagram.xml": f"<ModelInformation>{model}</ModelInformation>",
        "simulink/systems/system_root.xml": f"<System>{blocks}</System>",
        "simulink/systems/system_3.xml": f"<System>{INNER}</System>",
        "simulink/configSet0.xml": f"<ConfigSet><Object>{SETTINGS}</Object></ConfigSet>",
        "simulink/stateflow/chart_9.xml": MATLAB_FUNCTION,
        "metadata/coreProperties.xml": CORE.format(version="R2024a"),
        "metadata/mwcoreProperties.xml": "<mw xmlns='y'><matlabRelease>R2024a</matlabRelease></mw>",
    }


EVERY_SECOND = ("DigitalClock", "DiscreteIntegrator", "DiscretePulseGenerator", "DiscreteStateSpace", "UnitDelay",
                "ZeroOrderHold")  # fmt: skip
"""Types whose sample time a model names even where it is inherited."""
Blocks = list[tuple[Any, ...]]
"""Blocks as (type, name, values), or with what is inside, (type, name, values, (blocks, lines))."""
Lines = list[tuple[str, str]]
"""Lines from `name:port` to `name:port`, or to `name#enable`."""


def system(blocks: Blocks, lines: Lines, prefix: str = "") -> str:
    """Return the XML of a system with systems in it."""
    ids = {one[1]: f"{prefix}{k + 1}" for k, one in enumerate(blocks)}

    def pin(text: str, side: str) -> str:
        name, _, number = text.partition(":")
        block, _, kind = name.partition("#")
        return f"{ids[block]}#{kind}" if kind else f"{ids[name]}#{side}:{number or 1}"

    body = ""
    for kind, name, said, *inner in blocks:
        values = {**({"SampleTime": "-1"} if kind in EVERY_SECOND else {}), **said}
        given = "".join(
            f'<P Name="{key}">{escape(value)}</P>' for key, value in values.items() if not key.startswith("Interface")
        )
        interface = {key[9:]: value for key, value in values.items() if key.startswith("Interface")}
        if interface:
            entries = "".join(f'<P Name="{key}">{escape(value)}</P>' for key, value in interface.items())
            given += f'<List ListType="InterfaceData">{entries}</List>'
        within = system(*inner[0], prefix=f"{ids[name]}_") if inner else ""
        body += f'<Block BlockType="{kind}" Name="{name}" SID="{ids[name]}">{given}{within}</Block>'
    body += "".join(f'<Line><P Name="Src">{pin(a, "out")}</P><P Name="Dst">{pin(b, "in")}</P></Line>' for a, b in lines)
    return f"<System>{body}</System>"


def model(blocks: Blocks, lines: Lines) -> dict[str, str]:
    """Return the parts of a model."""
    inside = f"<ModelInformation><Model>{system(blocks, lines)}</Model></ModelInformation>"
    return {"simulink/blockdiagram.xml": inside}


def model_of(blocks: Blocks, lines: Lines, path: Path) -> Path:
    """Write a model with systems in it, and return its path."""
    return slx(model(blocks, lines), path)


def slx(files: dict[str, str], path: Path) -> Path:
    """Write parts as a .slx and return its path."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    path.write_bytes(buffer.getvalue())
    return path


def written(layout: str, folder: Path) -> Path:
    """Write the model in a layout and return its path: also `text`, the parts as one .mdl, and `braces`."""
    if layout == "braces":
        path = folder / "braces.mdl"
        path.write_text(BRACES, encoding="utf-8")
        return path
    if layout == "text":
        path = folder / "text.mdl"
        lines = ["# MathWorks OPC Text Package", "Model {", "  Version  24.1", "}", "__MWOPC_PACKAGE_BEGIN__ R2024a"]
        for name, content in parts("counts").items():
            lines += [f"__MWOPC_PART_BEGIN__ /{name}", content, ""]
        lines += ["__MWOPC_PART_BEGIN__ /metadata/thumbnail.png BASE64", "iVBORw0KGgo=", "__MWOPC_PACKAGE_END__", ""]
        path.write_text("\n".join(lines), encoding="utf-8")
        return path
    return slx(parts(layout), folder / f"{layout}.slx")
