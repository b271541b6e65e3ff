// Visibility of the light at a point of a surface: 1 lit, 0 shadowed.
//
// map: the shadow map's window depths, 1 where it is empty
// world_to_eye, eye_to_clip: the light's matrices, with which the map was drawn
// position: of the surface in world units; normal: of its plane, of length 1, not interpolated
// to_light: unit vector from there to the light
// pixel: counted from the picture's lower left pixel, which is (0, 0); only patterns use it
// layer: of the map; 0 if it has only one
float shadow(sampler2D map, mat4 world_to_eye, mat4 eye_to_clip, vec3 position, vec3 normal, vec3 to_light, vec2 pixel, int layer) {
    ShadowReceiver at = shadow_receiver(map, layer, world_to_eye, eye_to_clip, position, normal, to_light);
    // A surface that faces away from the light is dark.
    if (!(at.cosine > 0.0)) {
        return 0.0;
    }
    ShadowLookup to;
    to.layer = layer;
    to.texel = at.texel;
    to.depth = at.depth;
    bool in_front = at.in_front;
    if (SHADOW_HAS_NORMAL_OFFSET) {
        vec3 moved = position + normal * (shadow_normal_offset(at) * at.texel_size);
        vec4 place = shadow_project(map, world_to_eye, eye_to_clip, moved);
        to.texel = place.xy;
        to.depth = place.z;
        in_front = place.w > 0.0;
    }
    // What lies behind the light or beyond the map's far plane is lit.
    if (!in_front || to.depth > 1.0) {
        return 1.0;
    }
    to.depth = to.depth - shadow_bias(at);
    to.depth_per_texel = at.depth_per_texel;
    to.extent = shadow_extent(eye_to_clip, map);
    to.pixel = pixel;
    to.slope = vec2(0.0, 0.0);
    to.deepest = shadow_select(1000000.0, 1.0, SHADOW_FIXED_POINT);
    if (SHADOW_FOLLOWS_PLANE) {
        to.slope = vec2(at.slope.x * at.depth_per_texel, at.slope.y * at.depth_per_texel);
        to.deepest = min(to.deepest, to.depth + shadow_deepening(at));
    } else if (SHADOW_FIXED_POINT) {
        to.depth = clamp(to.depth, 0.0, 1.0);
    }
    return clamp(shadow_filter(map, to), 0.0, 1.0);
}
