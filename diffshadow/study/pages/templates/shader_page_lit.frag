// One light's part of the picture, and with the first of them the light of all directions. The exported shader stands
// above.
uniform sampler2D shadow_map;
uniform mat4 world_to_eye, eye_to_clip, light_to_eye[LAYERS], light_to_clip;
uniform vec2 size;
// Of what has w = 0, x, y and z are the unit vector towards it; of what has w = 1, they are its place.
uniform vec4 light, eye;
uniform vec3 intensity, ambient, attenuation, axis;
uniform float specular, shininess, cone_outer, cone_width, kept_in_shadow;
uniform bool blinn, has_cone, shows_visibility;
in vec3 place, corner_normal, albedo;
flat in vec3 face_normal;
out vec4 colour;
void main() {
    // Rasterizers move vertices to whole steps, of 1/16 pixel without a GPU. This takes the pixel's centre again.
    vec4 clip = eye_to_clip * (world_to_eye * vec4(place, 1.0));
    vec2 off = gl_FragCoord.xy - (clip.xy / clip.w * 0.5 + 0.5) * size;
    vec3 world = place + off.x * dFdx(place) + off.y * dFdy(place);
    vec3 to_camera = normalize(eye.xyz - eye.w * world);
    float side = dot(face_normal, to_camera) < 0.0 ? -1.0 : 1.0;
    vec3 path = light.xyz - light.w * world;
    vec3 to_light = normalize(path);
    int layer = LAYER;
    float lit = shadow(shadow_map, light_to_eye[layer], light_to_clip, world, side * face_normal, to_light, floor(gl_FragCoord.xy), layer);
    if (shows_visibility) {
        colour = vec4(vec3(lit / float(LIGHTS)), 1.0);
        return;
    }
    vec3 normal = side * normalize(corner_normal);
    float cosine = max(dot(normal, to_light), 0.0);
    vec3 mirrored = 2.0 * dot(normal, to_light) * normal - to_light;
    float highlight = blinn ? dot(normal, normalize(to_light + to_camera)) : dot(mirrored, to_camera);
    highlight = cosine > 0.0 && highlight > 0.0 ? pow(highlight, shininess) : 0.0;
    float arriving = 1.0;
    if (light.w > 0.0) {
        float d = length(path);
        arriving = 1.0 / (attenuation.x + attenuation.y * d + attenuation.z * d * d);
        if (has_cone) {
            float t = clamp((dot(-to_light, axis) - cone_outer) / cone_width, 0.0, 1.0);
            arriving *= t * t * (3.0 - 2.0 * t);
        }
    }
    vec3 all = albedo * ambient, own = arriving * intensity * (albedo * cosine + specular * highlight);
    // Shadow takes a light's own part away; or, as in OpenGL 1.4, a part of all light.
    colour = vec4(kept_in_shadow < 0.0 ? all + lit * own : mix(kept_in_shadow, 1.0, lit) * (all + own), 1.0);
}
