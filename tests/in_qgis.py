"""Runs in the Python of QGIS: one of the functions below with the plugin loaded; prints what it finds as one line of JSON.

python3 in_qgis.py FUNCTION COMMAND ARGUMENTS...
"""

import contextlib
import json
import os
import sys
from pathlib import Path

sys.path[:0] = [
    os.environ["QGIS_PROCESSING"],
    str(Path(__file__).resolve().parents[1] / "qgis"),
]

from qgis import core  # noqa: E402

APP = core.QgsApplication([], False)
APP.initQgis()
import processing  # noqa: E402
from jaxfilter_provider import classFactory  # noqa: E402
from jaxfilter_provider.provider import STYLERS  # noqa: E402
from processing.core.Processing import Processing  # noqa: E402
from processing.core.ProcessingConfig import ProcessingConfig  # noqa: E402
from qgis.PyQt.QtCore import QVariant  # noqa: E402

Processing.initialize()
PLUGIN = classFactory(None)
PLUGIN.initProcessing()


class Feedback(core.QgsProcessingFeedback):
    """Cancels at the first line of progress that begins with a word."""

    def __init__(self, word=None):
        super().__init__(False)
        self.word, self.shown = word, []

    def setProgressText(self, text):
        self.shown.append(text)
        if self.word is not None and text.startswith(self.word):
            self.cancel()


def cancel(folder, out):
    """Classify in many tiles, and cancel when they are being filtered."""
    feedback = Feedback("")
    parameters = {"FOLDER": folder, "METHOD": "ost", "OUTPUT": out, "TILE": 20.0, "MORE": "--wide-halos --workers 1"}
    results = processing.run("jaxfilter:ground", parameters, feedback=feedback)
    return {"shown": feedback.shown, "canceled": feedback.isCanceled(), "results": results, "log": feedback.textLog()}


def layers(folder, out):
    """Classify within a layer of the project, load all results, and tell their styles."""
    context = core.QgsProcessingContext()
    context.setProject(core.QgsProject.instance())
    area = core.QgsVectorLayer("Polygon?crs=EPSG:25832", "my area", "memory")
    feature = core.QgsFeature()
    feature.setGeometry(core.QgsGeometry.fromRect(core.QgsRectangle(512000, 5403000, 512040, 5403060)))
    area.dataProvider().addFeature(feature)
    core.QgsProject.instance().addMapLayer(area)
    feedback = Feedback()
    parameters = {"INPUT": [f"{folder}/a.laz"], "METHOD": "pmf", "OUTPUT": f"{out}/classified"}
    processing.run("jaxfilter:ground", {**parameters, "AOI": area.id(), "OUTPUT": f"{out}/part"}, feedback=feedback)
    review = core.QgsProcessingOutputLayerDefinition(f"{out}/places.gpkg", core.QgsProject.instance())
    processing.runAndLoadResults("jaxfilter:ground", {**parameters, "REVIEW": review}, feedback, context)
    parameters = {"INPUT": [f"{out}/classified/a.laz"], "CLASSIFIED": True, "ONLY": ["dtm", "hillshade"]}
    processing.runAndLoadResults("jaxfilter:products", {**parameters, "OUTPUT": f"{out}/p"}, feedback, context)
    found = {}
    for layer in core.QgsProject.instance().mapLayers().values():
        renderer = layer.renderer()
        found[layer.name()] = {"renderer": renderer.type(), "blend": int(layer.blendMode()), "source": layer.source()}
        if hasattr(renderer, "rootRule"):
            rules = [rule.filterExpression() for rule in renderer.rootRule().children()]
            found[layer.name()] |= {
                "sort": layer.attributeTableConfig().sortExpression(),
                "label": layer.labeling().settings().fieldName if layer.labelsEnabled() else None,
                "rules": rules,
                "drawn": [
                    sum(core.QgsExpression(rule).evaluate(_row(layer, one)) == 1 for rule in rules)
                    for one in layer.getFeatures()
                ],
            }
    return {"layers": found, "log": feedback.textLog()}


def _row(layer, feature):
    """What expressions see of a feature."""
    context = core.QgsExpressionContext(core.QgsExpressionContextUtils.globalProjectLayerScopes(layer))
    context.setFeature(feature)
    return context


def edits(places):
    """Apply a list of places whose edits are not saved, and then one that is no file."""
    said = []
    layer = core.QgsVectorLayer(f"{places}|layername=review", "my places", "ogr")
    layer.startEditing()
    layer.addAttribute(core.QgsField("note", QVariant.String))
    memory = core.QgsVectorLayer("Polygon?crs=EPSG:25832", "in memory", "memory")
    for one in (layer, memory):
        feedback = Feedback()
        with contextlib.suppress(core.QgsProcessingException):
            processing.run("jaxfilter:apply", {"PLACES": one, "FOLDER": str(Path(places).parent)}, feedback=feedback)
        said.append(feedback.textLog())
    return said


def points(cloud):
    """The style of classes, on a point cloud of a kind that any QGIS reads."""
    layer = core.QgsPointCloudLayer(cloud, "points", "ept")
    STYLERS["classes"].postProcessLayer(layer, None, None)
    categories = {one.value(): one.color().name() for one in layer.renderer().categories()}
    return {"valid": layer.isValid(), "type": layer.renderer().type(), "categories": categories}


ProcessingConfig.setSettingValue("JAXFILTER_COMMAND", sys.argv[2])
print("\n" + json.dumps(globals()[sys.argv[1]](*sys.argv[3:])), flush=True)
os._exit(0)  # QGIS may crash on its way out
