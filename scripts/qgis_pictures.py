"""What ``scripts/draw_qgis`` does inside QGIS: it follows docs/qgis.md, and keeps pictures of the screen."""

import os
import sys
import traceback
from pathlib import Path

from qgis.core import QgsPointXY, QgsProject, QgsRectangle, QgsVectorLayer
from qgis.PyQt.QtCore import QPoint, Qt, QTimer
from qgis.PyQt.QtTest import QTest
from qgis.PyQt.QtWidgets import QApplication, QDockWidget, QTabWidget
from qgis.utils import iface

FOLDER = Path(os.environ["MSBDB_TOWNS"])
ARENA = QgsRectangle(809280, 6304870, 809420, 6305010)
FORM = (560, 200, 700, 500)
"""Left, top, width and height of the form on the screen."""

LEGEND, RESULTS = 270, 420
"""Widths of the panels of layers and of what was identified."""

DRAWING_MS = 2500
"""How long QGIS may draw; it draws this town in less than a second."""


def opened(name: str) -> None:
    """Open a project."""
    QgsProject.instance().read(str(FOLDER / f"{name}.qgz"))
    QTest.qWait(DRAWING_MS)


def layer(title: str) -> QgsVectorLayer:
    """Return a layer by its title."""
    return QgsProject.instance().mapLayersByName(title)[0]


def show(*titles: str) -> None:
    """Show these layers alone, with their legends unfolded."""
    for leaf in QgsProject.instance().layerTreeRoot().findLayers():
        leaf.setItemVisibilityChecked(leaf.name() in titles)
        leaf.setExpanded(leaf.name() in titles)
    iface.setActiveLayer(layer(titles[0]))


def keep(name: str) -> None:
    """Wait until all is drawn, and keep a picture of the screen."""
    QTest.qWait(DRAWING_MS)
    if not QApplication.primaryScreen().grabWindow(0).save(str(FOLDER / f"qgis_{name}.png")):
        raise OSError(name)


def click(point: QgsPointXY) -> None:
    """Click a place of the map."""
    canvas = iface.mapCanvas()
    place = canvas.getCoordinateTransform().transform(point)
    spot = QPoint(int(place.x()), int(place.y()))
    QTest.mouseMove(canvas.viewport(), spot)
    QTest.mouseClick(canvas.viewport(), Qt.LeftButton, Qt.NoModifier, spot)


def widen() -> None:
    """Give the panels their widths."""
    widths = {"Layers": LEGEND, "Identify Results": RESULTS}
    docks = [dock for dock in iface.mainWindow().findChildren(QDockWidget) if dock.windowTitle() in widths]
    iface.mainWindow().resizeDocks(docks, [widths[dock.windowTitle()] for dock in docks], Qt.Horizontal)


def walk() -> None:
    """Go through the page."""
    window = iface.mainWindow()
    window.setGeometry(QApplication.primaryScreen().geometry())
    for dock in window.findChildren(QDockWidget, "Browser"):
        dock.hide()
    widen()
    opened("nimes")
    keep("height")

    by_height = layer("Buildings by height")
    iface.setActiveLayer(by_height)
    arena = max(by_height.getFeatures(), key=lambda row: row["area_m2"])
    iface.actionIdentify().trigger()
    click(arena.geometry().pointOnSurface().asPoint())
    QTest.qWait(DRAWING_MS)
    widen()
    form = iface.getFeatureForm(by_height, arena)
    form.setGeometry(*FORM)
    form.show()
    tabs = form.findChildren(QTabWidget)[0]
    tabs.setCurrentIndex(tabs.count() - 1)
    keep("form")
    form.close()
    for dock in window.findChildren(QDockWidget):
        if dock.windowTitle() == "Identify Results":
            dock.hide()
    widen()
    iface.actionPan().trigger()

    show("Parts of buildings by scale")
    iface.mapCanvas().setExtent(ARENA)
    keep("parts")

    iface.mapCanvas().setExtent(by_height.extent())
    show("Buildings by state")
    layer("Buildings by state").selectByExpression("\"state\" = 'unsure'")
    keep("state")

    opened("town")
    iface.mapCanvas().setExtent(layer("Buildings by state").extent())
    show("Changes by kind", "Buildings by state")
    keep("changes")


def main() -> None:
    """Walk, and end QGIS."""
    code = 0
    try:
        walk()
    except Exception:
        traceback.print_exc(file=sys.stdout)
        code = 1
    sys.stdout.flush()
    os._exit(code)


QTimer.singleShot(DRAWING_MS, main)
