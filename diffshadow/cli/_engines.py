"""Commands for engines and other renderers: convert, export, defaults and import."""

from pathlib import Path

from ..config import load_config, settings_file
from ..console import Command, Console, source, to_view
from ..settings.engines import EngineName, ImportedTechnique, ShadowType, ThreeJs
from ..settings.scene import LightKind
from ..settings.techniques import ShaderLanguage
from ._app import app, print_end, print_notes, to_try
from ._jax import start_jax


@app.command
def convert(config: Path, /, *overrides: str, engine: EngineName | None = None) -> None:
    """Prints the bias and the radius of CONFIG in the units of engines, or the code for one of them.

    For the folder of a finished fit, it converts the fitted values. If engines lack the bias, such as a slope or a
    receiver plane bias, it fits the shadows of three.js and Babylon.js instead, which takes as long as two fits. For
    other engines, it prints the command for such a fit. The technique may be an engine's own.

    Example: `diffshadow convert runs/quickstart`

    Example: `diffshadow convert configs/quickstart.yaml bias.slope=0 bias.constant=1.5`

    Example: `diffshadow convert runs/quickstart --engine bevy`

    Parameters
    ----------
    config
        YAML file with technique type shadow_map or an engine's, mesh file, folder of a finished run or
        builtin:NAME.
    overrides
        KEY=VALUE pairs that replace values of the file, such as `bias.constant=2`.
    engine
        The only engine to convert to: its finished code is printed.
    """
    file, origin = settings_file(config)
    settings = load_config(file, overrides)
    print_notes(settings.notes)
    origin += f", with {' '.join(overrides)}" if overrides else ""
    start_jax()
    from .. import study

    study.convert(settings, console=Console(), origin=origin, source=config, overrides=overrides, engine=engine)
    given = source(config)
    commands = [study.for_engine(given, overrides, engine), to_view(given, overrides)]
    if settings.technique.type == "shadow_map":
        commands.append(Command("Write it as a shader for your own renderer.", ["export", given, *overrides]))
    print_end(None, commands)


@app.command
def export(
    config: Path, /, *overrides: str, shader: ShaderLanguage = "glsl", page: bool = False, output: Path | None = None
) -> None:
    """Writes the shadows of CONFIG as a shader for your own renderer.

    For the folder of a finished fit, the shader has the fitted values. The folder also has the scene, the light's
    matrices, and a page that says how to draw the shadow map in OpenGL, WebGPU and Direct3D. The path of the shader's
    folder is the last line printed.

    Example: `diffshadow export runs/quickstart`

    Example: `diffshadow export configs/quickstart.yaml --shader wgsl --output my_shadow`

    Example: `diffshadow export runs/quickstart --page`

    Parameters
    ----------
    config
        YAML file with technique type shadow_map, mesh file, folder of a finished run or builtin:NAME.
    overrides
        KEY=VALUE pairs that replace values of the file, such as `bias.constant=2`.
    shader
        Language: glsl (3.30 or ES 3.00), wgsl or hlsl (shader model 5).
    page
        Also writes page.html, which draws the scene in a browser with the exported shader in GLSL: before the fit and
        after it, or with default values and these.
    output
        Folder to write to, by default one named like the configuration, in the current folder.
    """
    file, origin = settings_file(config)
    settings = load_config(file, overrides)
    print_notes(settings.notes)
    start_jax()
    from .. import study

    folder = Path(f"{settings.name}-shader") if output is None else output
    compared = study.compared_with(settings, file, overrides) if page else None
    made = study.export_shader(settings, folder, shader, console=Console(), origin=origin, compared=compared)
    print_end(made, [to_view(source(config), overrides), study.to_convert(source(config), overrides)])


@app.command
def defaults(
    *,
    filter: str | None = None,
    radius: float | None = None,
    engine: EngineName | None = None,
    map: int | None = None,
    window: float | None = None,
    depth: float | None = None,
    light: LightKind = "directional",
    angle: float | None = None,
    near: float | None = None,
    distance: float | None = None,
) -> None:
    """Prints rules of thumb: biases that work in many scenes, and how much more error than a fit they have.

    Example: `diffshadow defaults --filter random_disk --radius 3`

    Example: `diffshadow defaults --engine three.js`

    Example: `diffshadow defaults --engine godot --map 2048 --window 40 --depth 100`

    Example: `diffshadow defaults --engine unity --light spot --map 1024 --angle 30 --near 0.5 --depth 20 --distance 6`

    Parameters
    ----------
    filter
        Type of a filter, such as pcf, whose bias is printed as a part of a configuration.
    radius
        Its radius in texels.
    engine
        Engine whose settings are printed, for its default filter.
    map
        Texels along a side of the engine's map, by default as the engine has it.
    window
        How wide a directional light's shadow camera is, in world units, by default as in the engine.
    depth
        Its far plane less its near plane, in world units, for a directional light by default as in the engine.
    light
        Kind of the engine's light.
    angle
        Half the angle of a spot light's cone, in degrees.
    near
        Near plane of a spot or point light, in world units.
    distance
        Distance from a spot or point light at which the settings hold, in world units.
    """
    from .. import study

    of_map = study.LightOptions(light, map, window, depth, angle, near, distance)
    study.print_defaults(console=Console(), filter=filter, radius=radius, engine=engine, of_map=of_map)
    print_end(None, study.after_defaults(filter, radius, engine))


@app.command(name="import")
def import_(
    scene: Path,
    /,
    *,
    camera: str | None = None,
    light: str | None = None,
    technique: ImportedTechnique = "three.js",
    shadow_type: ShadowType = ThreeJs.shadow_type,
    output: Path | None = None,
) -> None:
    """Makes a configuration of SCENE, a file that three.js or another program stored: JSON of scene.toJSON(), GLB or
    glTF 2.0.

    Prints what is imported, what is left out, and what differs from the scene. The path of the configuration is the
    last line printed.

    Example: `diffshadow import scene.json --output scene`

    Parameters
    ----------
    scene
        The scene's file.
    camera
        Name of the camera, by default the first; or the file of a scene that holds one.
    light
        Name of the light, by default the first that casts shadows.
    technique
        Technique of the configuration; three.js takes the settings of the light's shadow over.
    shadow_type
        Type of renderer.shadowMap, which no scene's file holds.
    output
        Folder for the configuration and its meshes, by default one named like the file, in the current folder.
    """
    from .. import study

    made = study.import_scene(
        scene,
        console=Console(),
        camera=camera,
        light=light,
        technique=technique,
        shadow_type=shadow_type,
        output=output,
    )
    print_end(made, to_try(made))
