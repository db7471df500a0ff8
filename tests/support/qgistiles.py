"""Draw vector tiles by QGIS; Debian's own Python runs this. It prints the zooms of the layer and the painted share.

Arguments: an address of tiles with {z}, {y} and {x}; west, south, east and north of the map, EPSG:3857.
"""

import sys
from urllib.parse import quote

from qgis.core import (
    QgsApplication,
    QgsCoordinateReferenceSystem,
    QgsMapRendererParallelJob,
    QgsMapSettings,
    QgsRectangle,
    QgsVectorTileLayer,
)
from qgis.PyQt.QtCore import QSize
from qgis.PyQt.QtGui import QColor

SIDE, PAPER = 500, QColor("white")
"""Pixels a side of the map, and the colour where nothing is."""

application = QgsApplication([], False)
application.initQgis()
layer = QgsVectorTileLayer(f"type=xyz&url={quote(sys.argv[1], safe=':/')}&zmin=12&zmax=22", "tiles")
if not layer.isValid():
    sys.exit(f"QGIS does not open {sys.argv[1]}.")
settings = QgsMapSettings()
settings.setLayers([layer])
settings.setOutputSize(QSize(SIDE, SIDE))
settings.setDestinationCrs(QgsCoordinateReferenceSystem("EPSG:3857"))
settings.setExtent(QgsRectangle(*map(float, sys.argv[2:6])))
settings.setBackgroundColor(PAPER)
job = QgsMapRendererParallelJob(settings)
job.start()
job.waitForFinished()
if job.errors():
    sys.exit("\n".join(error.message for error in job.errors()))
image = job.renderedImage()
painted = sum(image.pixelColor(x, y) != PAPER for x in range(SIDE) for y in range(SIDE))
sys.stdout.write(f"{layer.sourceMinZoom()} {layer.sourceMaxZoom()} {painted / SIDE**2:.4f}\n")
del layer
application.exitQgis()
