// The sum of all lights as it is shown.
precision highp float;
precision highp sampler2D;
uniform sampler2D linear;
uniform vec3 background;
uniform bool shows_visibility;
out vec4 colour;
void main() {
    vec4 seen = texelFetch(linear, ivec2(gl_FragCoord.xy), 0);
    vec3 c = clamp(seen.a > 0.0 ? seen.rgb : shows_visibility ? vec3(1.0) : background, 0.0, 1.0);
    vec3 srgb = mix(1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, 12.92 * c, lessThanEqual(c, vec3(0.0031308)));
    colour = vec4(shows_visibility ? c : srgb, 1.0);
}
