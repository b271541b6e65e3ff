extends Node3D
# Draws the job that the page left in `window.job`, and hands its picture back. `engines.py` says what a job holds.

var job := {}
var frames := 0

func to_vectors(flat: Array) -> PackedVector3Array:
	var found := PackedVector3Array()
	for i in range(0, flat.size(), 3):
		found.append(Vector3(flat[i], flat[i + 1], flat[i + 2]))
	return found

func to_vector(of: Array) -> Vector3:
	return Vector3(of[0], of[1], of[2])

func add_mesh(given: Dictionary) -> void:
	var arrays := []
	arrays.resize(Mesh.ARRAY_MAX)
	arrays[Mesh.ARRAY_VERTEX] = to_vectors(given.vertices)
	arrays[Mesh.ARRAY_NORMAL] = to_vectors(given.normals)
	var faces := PackedInt32Array()
	# Front faces are clockwise in Godot.
	for i in range(0, given.faces.size(), 3):
		faces.append_array([int(given.faces[i]), int(given.faces[i + 2]), int(given.faces[i + 1])])
	arrays[Mesh.ARRAY_INDEX] = faces
	var mesh := ArrayMesh.new()
	mesh.add_surface_from_arrays(Mesh.PRIMITIVE_TRIANGLES, arrays)
	var culls := {"front": "cull_back", "back": "cull_front", "double": "cull_disabled"}
	var material := ShaderMaterial.new()
	material.shader = Shader.new()
	material.shader.code = """shader_type spatial;
render_mode ambient_light_disabled, specular_disabled, %s;
void fragment() { ALBEDO = vec3(1.0); }
void light() { DIFFUSE_LIGHT += vec3(ATTENUATION); }""" % culls[given.get("side", "front")]
	var instance := MeshInstance3D.new()
	instance.mesh = mesh
	instance.material_override = material
	if not given.get("casts", true):
		instance.cast_shadow = GeometryInstance3D.SHADOW_CASTING_SETTING_OFF
	add_child(instance)

func add_camera(given: Dictionary) -> void:
	var camera := Camera3D.new()
	camera.fov = given.fov
	camera.near = given.near
	camera.far = given.far
	add_child(camera)
	if given.has("pose"):
		var m: Array = given.pose
		camera.transform = Transform3D(Basis(Vector3(m[0], m[4], m[8]), Vector3(m[1], m[5], m[9]), Vector3(m[2], m[6], m[10])), Vector3(m[3], m[7], m[11]))
	else:
		camera.look_at_from_position(to_vector(given.position), to_vector(given.target), to_vector(given.get("up", [0, 1, 0])))
	camera.current = true

func add_light(given: Dictionary) -> void:
	var light: Light3D
	var at := to_vector(given.get("position", [0, 0, 0]))
	if given.type == "directional":
		light = DirectionalLight3D.new()
	elif given.type == "spot":
		light = SpotLight3D.new()
		light.spot_attenuation = 0.0001
		light.spot_angle_attenuation = 0.0001
	else:
		light = OmniLight3D.new()
		light.omni_attenuation = 0.0001
	add_child(light)
	light.position = at
	if given.has("direction"):
		light.look_at_from_position(at, at + to_vector(given.direction))
	light.shadow_enabled = job.get("shadow", true)
	for name in given:
		if not (name in ["type", "position", "direction"]):
			light.set(name, given[name])

func _ready() -> void:
	job = JSON.parse_string(JavaScriptBridge.eval("JSON.stringify(window.job)"))
	RenderingServer.directional_shadow_atlas_set_size(int(job.size), false)
	RenderingServer.directional_soft_shadow_filter_set_quality(int(job.quality))
	RenderingServer.positional_soft_shadow_filter_set_quality(int(job.quality))
	# One light has a quadrant of the atlas to itself.
	get_viewport().positional_shadow_atlas_size = 2 * int(job.size)
	get_viewport().positional_shadow_atlas_16_bits = false
	for quadrant in 4:
		get_viewport().set_positional_shadow_atlas_quadrant_subdiv(quadrant, Viewport.SHADOW_ATLAS_QUADRANT_SUBDIV_1)
	for mesh in job.meshes:
		add_mesh(mesh)
	var world := WorldEnvironment.new()
	world.environment = Environment.new()
	world.environment.background_mode = Environment.BG_COLOR
	world.environment.background_color = Color(0, 0, 0)
	world.environment.ambient_light_source = Environment.AMBIENT_SOURCE_DISABLED
	world.environment.tonemap_mode = Environment.TONE_MAPPER_LINEAR
	add_child(world)
	add_camera(job.camera)
	add_light(job.light)

func _process(_delta: float) -> void:
	frames += 1
	# The first frames may lack what is still being compiled.
	if frames != 12:
		return
	await RenderingServer.frame_post_draw
	var image := get_viewport().get_texture().get_image()
	image.convert(Image.FORMAT_RGB8)
	var text := "window.drawn = { width: %d, height: %d, version: '%s', rgb: '%s' };"
	JavaScriptBridge.eval(text % [image.get_width(), image.get_height(), Engine.get_version_info().string, Marshalls.raw_to_base64(image.get_data())])
