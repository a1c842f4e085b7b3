"""Results as JUnit XML, which continuous integration shows as a list of tests."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence

from twodof.compile.diagram_test.judgement import ScenarioResult
from twodof.errors import printable


def to_junit(results: Mapping[str, Sequence[ScenarioResult]]) -> str:
    """The results of each file of tests, by the file's name: a `testcase` an assertion, with its scenario as class."""
    root = ElementTree.Element("testsuites")
    for file, scenarios in results.items():
        judgements = [(s, j) for s in scenarios for j in s.judgements]
        failed = sum(not j.passed for _, j in judgements)
        suite = ElementTree.SubElement(
            root, "testsuite", name=printable(file), tests=str(len(judgements)), failures=str(failed), errors="0"
        )
        for scenario, judgement in judgements:
            case = ElementTree.SubElement(suite, "testcase", classname=scenario.name, name=judgement.check)
            if not judgement.passed:
                ElementTree.SubElement(case, "failure", message=printable(judgement.text))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"
