"""Debian's QGIS without a screen: it opens a project and says what it finds."""

import subprocess
import tempfile
from pathlib import Path

import pytest

PYTHON = "/usr/bin/python3"
"""The Python for which Debian installs the modules of QGIS."""

LOAD = """
import sys
from qgis.core import *
from qgis.PyQt.QtCore import QSize
app = QgsApplication([], False)
app.initQgis()
messages = []
QgsApplication.messageLog().messageReceived.connect(lambda *words: messages.append(words))
project = QgsProject.instance()
assert project.read(sys.argv[1])
assert project.crs().authid() == sys.argv[2], project.crs().authid()
for layer in project.mapLayers().values():
    assert layer.isValid(), layer.source()
    for feature in layer.getFeatures():
        pass
    print(layer.id(), layer.featureCount())
for relation in project.relationManager().relations().values():
    assert relation.isValid(), relation.validationError()
    rows = relation.referencedLayer().getFeatures()
    print(relation.id(), sum(len(list(relation.getRelatedFeatures(row))) for row in rows))
height = project.mapLayer("footprint_by_height")
settings = QgsMapSettings()
settings.setLayers([height])
settings.setDestinationCrs(project.crs())
settings.setExtent(height.extent())
settings.setOutputSize(QSize(400, 300))
job = QgsMapRendererParallelJob(settings)
job.start()
job.waitForFinished()
image = job.renderedImage()
colours = {image.pixelColor(x, y).name() for x in range(0, image.width(), 4) for y in range(0, image.height(), 4)}
print("colours", len(colours))
alias = {field.name(): field.alias() for field in height.fields()}
print("alias", alias["ridge"])
assert not messages, messages
"""
"""Opens a project, reads and draws its layers, follows its relations, and prints what it found."""


def opened_by_qgis(source: object, epsg: int) -> str:
    """Return what QGIS finds in a project; skip the test where QGIS is not installed, and fail where it complains."""
    if not Path(PYTHON).exists() or subprocess.run([PYTHON, "-c", "import qgis.core"], check=False).returncode:
        pytest.skip("QGIS is not installed; apt-get install qgis python3-qgis")
    with tempfile.TemporaryDirectory() as home:
        environment = {"QT_QPA_PLATFORM": "offscreen", "HOME": home, "PATH": "/usr/bin:/bin"}
        words = [PYTHON, "-c", LOAD, str(source), f"EPSG:{epsg}"]
        done = subprocess.run(words, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    assert "warning" not in done.stderr.lower(), done.stderr
    return done.stdout
