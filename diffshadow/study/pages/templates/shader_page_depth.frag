// Depth in the middle of each texel: rasterizers move vertices to whole steps, of 1/16 texel without a GPU.
precision highp float;
uniform mat4 world_to_eye, eye_to_clip;
uniform vec4 viewport;
in vec3 place;
void main() {
    vec4 clip = eye_to_clip * (world_to_eye * vec4(place, 1.0));
    vec3 window = clip.xyz / clip.w * 0.5 + 0.5;
    vec2 off = gl_FragCoord.xy - viewport.xy - window.xy * viewport.zw;
    gl_FragDepth = window.z + off.x * dFdx(window.z) + off.y * dFdy(window.z);
}
