// All passes give a vertex the same place, to the bit.
invariant gl_Position;
uniform mat4 world_to_eye, eye_to_clip;
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 face_normal_in;
layout(location = 2) in vec3 corner_normal_in;
layout(location = 3) in vec3 colour_in;
out vec3 place, corner_normal, albedo;
flat out vec3 face_normal;
void main() {
    place = position;
    face_normal = face_normal_in;
    corner_normal = corner_normal_in;
    albedo = colour_in;
    gl_Position = eye_to_clip * (world_to_eye * vec4(position, 1.0));
}
