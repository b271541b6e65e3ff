// Visibility in a layer of the map.
float shadow_in_view(SHADOW_MAPS, ShadowView view, vec3 position, vec3 normal, vec3 to_light, vec2 pixel) {
    ShadowReceiver at = shadow_receiver(map, view, position, normal, to_light);
    // A surface that faces away from the light is dark.
    if (!(at.cosine > 0.0)) {
        return 0.0;
    }
    ShadowLookup to;
    to.layer = view.layer;
    to.texel = at.texel;
    to.depth = at.depth;
    bool in_front = at.in_front;
    if (SHADOW_HAS_NORMAL_OFFSET) {
        vec3 moved = position + normal * (shadow_normal_offset(at) * at.texel_size);
        vec4 place = shadow_project(view, moved);
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
    to.extent = shadow_extent(view, to.texel);
    to.pixel = pixel;
    to.slope = vec2(0.0, 0.0);
    to.deepest = shadow_select(1000000.0, 1.0, SHADOW_FIXED_POINT);
    if (SHADOW_FOLLOWS_PLANE) {
        to.slope = vec2(at.slope.x * at.depth_per_texel, at.slope.y * at.depth_per_texel);
        to.deepest = min(to.deepest, to.depth + shadow_deepening(at));
    } else if (SHADOW_FIXED_POINT) {
        to.depth = clamp(to.depth, 0.0, 1.0);
    }
    return clamp(shadow_filter(shadow_maps, to), 0.0, 1.0);
}
