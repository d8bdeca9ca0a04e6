"""The provider: each declaration of ``algorithms.py`` as an algorithm of QGIS."""

from __future__ import annotations

import os
import shlex
from pathlib import Path
from typing import Any

from processing.core.ProcessingConfig import ProcessingConfig, Setting
from qgis import core
from qgis.PyQt.QtGui import QIcon

from .algorithms import ALGORITHMS, Algorithm, Parameter, Result, command_line, in_labels
from .command import NAME, CommandError, find, run

HERE = Path(__file__).resolve().parent
SETTING, SETTING_WORDS = "JAXFILTER_COMMAND", "Path of the command jaxfilter, or of the environment that holds it"
_LOADED = 20  # files of points, at most


class Plugin:
    """The plugin, in QGIS and in qgis_process."""

    def initProcessing(self) -> None:
        self.provider = Provider()
        core.QgsApplication.processingRegistry().addProvider(self.provider)

    initGui = initProcessing

    def unload(self) -> None:
        core.QgsApplication.processingRegistry().removeProvider(self.provider)


class Provider(core.QgsProcessingProvider):
    """The group of algorithms, and its setting."""

    def id(self) -> str:
        return NAME

    name = id

    def icon(self) -> QIcon:
        return QIcon(str(HERE / "icon.svg"))

    def load(self) -> bool:
        ProcessingConfig.settingIcons[NAME] = self.icon()
        ProcessingConfig.addSetting(Setting(NAME, SETTING, SETTING_WORDS, "", valuetype=Setting.FILE))
        ProcessingConfig.readSettings()
        self.refreshAlgorithms()
        return True

    def unload(self) -> None:
        ProcessingConfig.removeSetting(SETTING)

    def loadAlgorithms(self) -> None:
        for declared in ALGORITHMS:
            self.addAlgorithm(Command(declared))


class Styler(core.QgsProcessingLayerPostProcessorInterface):
    """Gives a layer one of the styles of the plugin when QGIS has loaded it."""

    def __init__(self, style: str) -> None:
        super().__init__()
        self.path = str(HERE / "styles" / f"{style}.qml")

    def postProcessLayer(self, layer: Any, context: Any, feedback: Any) -> None:
        layer.loadNamedStyle(self.path)
        layer.triggerRepaint()


STYLERS = {style: Styler(style) for style in ("classes", "hillshade", "places", "")}  # kept alive
_POLYGONS, _POINTS = core.QgsProcessing.TypeVectorPolygon, core.QgsProcessing.TypePointCloud
_MANY = {"uses_static_strings": True, "allow_multiple": True}
_OPTIONAL, _ADVANCED = 8, 2  # flags of parameters
KINDS: dict[str, tuple[str, str, dict[str, Any]]] = {
    "clouds": ("multilayer", "", {"layer_type": _POINTS}),
    "polygons": ("vector", "", {"data_types": [_POLYGONS]}),
    "list of places": ("vector", "", {"data_types": [_POLYGONS]}),
    "raster": ("raster", "", {}),
    "folder": ("file", "String", {"behavior": 1}),
    "table": ("file", "String", {"filefilter": "CSV files (*.csv);;All files (*.*)"}),
    "choice": ("enum", "EnumString", {"uses_static_strings": True}),
    "choices": ("enum", "EnumStrings", _MANY),
    "list": ("enum", "EnumStrings", _MANY),
    "number": ("number", "Double", {"data_type": 1, "min": 0.0, "max": 1e9}),
    "count": ("number", "Int", {"data_type": 0, "min": 1, "max": 9999}),
    "class": ("number", "Int", {"data_type": 0, "min": 0, "max": 255}),
    "switch": ("boolean", "Bool", {}),
    "crs": ("crs", "Crs", {}),
    "text": ("string", "String", {}),
    "words": ("string", "String", {}),
    "new folder": ("folderDestination", "FileOutput", {}),
    "new points": ("fileDestination", "FileOutput", {"file_filter": "LAZ (*.laz);;COPC (*.copc.laz);;LAS (*.las)"}),
    "new page": ("fileDestination", "FileOutput", {"file_filter": "HTML files (*.html)"}),
    "new places": ("vectorDestination", "OutputLayer", {"data_type": _POLYGONS}),
}
"""The parameter of each kind in QGIS, what reads its value (parameterAs...; nothing: ``_file_of``), and what it has more."""


def made(one: Parameter) -> Any:
    """The parameter of QGIS of a declaration."""
    values = {"parameter_type": KINDS[one.kind][0], "name": one.name, "description": one.label, "default": one.default}
    values["flags"] = _OPTIONAL * (one.default is None and not one.needed) | _ADVANCED * one.advanced
    values |= {"options": list(one.choices), "create_by_default": one.needed, **KINDS[one.kind][2]}
    parameter = core.QgsProcessingParameters.parameterFromVariantMap(values)
    parameter.setHelp(one.tip)
    return parameter


class Command(core.QgsProcessingAlgorithm):
    """An algorithm that runs the command."""

    def __init__(self, declared: Algorithm) -> None:
        super().__init__()
        self.declared, self.inputs = declared, {}

    def createInstance(self) -> Command:
        return Command(self.declared)

    def name(self) -> str:
        return self.declared.name

    def displayName(self) -> str:
        return self.declared.title

    icon = Provider.icon

    def shortHelpString(self) -> str:
        return " ".join((HERE / "help" / f"{self.declared.name}.html").read_text(encoding="utf-8").split())

    def initAlgorithm(self, configuration: Any = None) -> None:
        for one in self.declared.parameters:
            self.addParameter(made(one))
        kinds = {"tif": core.QgsProcessingOutputRasterLayer, "tml": core.QgsProcessingOutputHtml}
        for result in (one for one in self.declared.results if one.name):
            self.addOutput(kinds[result.pattern[-3:]](result.name, result.pattern))

    def canExecute(self) -> tuple[bool, str]:
        try:
            return bool(find(ProcessingConfig.getSetting(SETTING) or "")), ""
        except CommandError as error:
            return False, str(error)

    def checkParameterValues(self, parameters: dict[str, Any], context: Any) -> tuple[bool, str]:
        if not parameters.get("INPUT") and not parameters.get("FOLDER"):
            return False, "Name the points: choose layers or files, or a folder of files"
        return super().checkParameterValues({**parameters, "INPUT": None}, context)  # QGIS would load and index it

    def validateInputCrs(self, parameters: dict[str, Any], context: Any) -> bool:
        return True  # the command checks them

    def prepareAlgorithm(self, parameters: dict[str, Any], context: Any, feedback: Any) -> bool:
        """Look up the files of layers, which belong to the main thread."""
        for one in self.declared.parameters:
            value = parameters.get(one.name)
            if KINDS[one.kind][1] or not value:
                continue
            if one.kind == "polygons":  # a file with nothing else in it: --aoi takes the first layer of a file
                read = self.parameterAsCompatibleSourceLayerPath
                self.inputs[one.name] = read(parameters, one.name, context, [], "gpkg", feedback)
            else:
                values = value if isinstance(value, (list, tuple)) else [value]
                self.inputs[one.name] = [_file_of(v, context) for v in values]
        return True

    def _value(self, one: Parameter, parameters: dict[str, Any], context: Any) -> Any:
        """The value of a parameter, as the command takes it; None if there is none."""
        read = KINDS[one.kind][1]
        if not read:
            return self.inputs.get(one.name)
        if parameters.get(one.name) is None and (one.default is None or one.kind.startswith("new ")):
            return None
        value = getattr(self, f"parameterAs{read}")(parameters, one.name, context)
        value = value.authid().partition("USER:")[0] or value.toWkt() if one.kind == "crs" else value
        return os.path.join(value, "") if one.kind == "new folder" else value

    def processAlgorithm(self, parameters: dict[str, Any], context: Any, feedback: Any) -> dict[str, Any]:
        values = {one.name: self._value(one, parameters, context) for one in self.declared.parameters}
        try:
            program = find(ProcessingConfig.getSetting(SETTING) or "")
            line = [program, *command_line(self.declared, values), "--progress-every", "1"]
            feedback.pushCommandInfo(" ".join(map(shlex.quote, line)))
            if not run(line, feedback):
                return {}
        except CommandError as error:
            raise core.QgsProcessingException(in_labels(self.declared, str(error))) from None
        outputs = {one.name: values[one.name] for one in self.declared.parameters if one.kind.startswith("new ")}
        for result in self.declared.results:
            if where := values[result.of]:
                paths = [str(path) for path in sorted(Path(where).glob(result.pattern))] if result.pattern else [where]
                if result.name and paths:
                    outputs[result.name] = paths[0]
                _load(result, paths, values.get("LOAD"), context, feedback)
        return {name: value for name, value in outputs.items() if value and os.path.exists(value)}


def _file_of(value: Any, context: Any) -> str:
    """The file of a layer, or of its id or name in the project; any other text is that of a file."""
    of_project = core.QgsProcessingUtils.mapLayerFromString
    layer = value if isinstance(value, core.QgsMapLayer) else of_project(str(value), context, False)
    if layer is None:
        return str(value).split("|")[0]
    if layer.isEditable() and layer.isModified():
        raise core.QgsProcessingException(f"{layer.name()} has edits that are not saved: save them first")
    parts = core.QgsProviderRegistry.instance().decodeUri(layer.dataProvider().name(), layer.source())
    if not parts.get("path"):
        raise core.QgsProcessingException(f"{layer.name()} has no file: name a layer that has one, or a file")
    return str(parts["path"])


def _load(result: Result, paths: list[str], wanted: Any, context: Any, feedback: Any) -> None:
    """Let QGIS load files with their style when the algorithm is done. Lists of places it loads itself, if that is chosen."""
    clouds, hints = result.style == "classes", core.QgsProcessingUtils.LayerHint
    if clouds and wanted and "pdal" not in core.QgsProviderRegistry.instance().providerList():
        feedback.pushInfo("This QGIS cannot read LAS, so the classified files are not loaded.")
    elif wanted and (clouds or result.pattern.endswith("tif")) and context.project() is not None:
        if len(paths) > _LOADED:
            feedback.pushInfo(f"The first {_LOADED} of {len(paths)} classified files are loaded.")
        for path in paths[:_LOADED]:
            hint = hints.PointCloud if clouds else hints.Raster
            details = core.QgsProcessingContext.LayerDetails(Path(path).stem, context.project(), result.name, hint)
            context.addLayerToLoadOnCompletion(path, details)
    for path in filter(context.willLoadLayerOnCompletion, paths):
        context.layerToLoadOnCompletionDetails(path).setPostProcessor(STYLERS[result.style])
