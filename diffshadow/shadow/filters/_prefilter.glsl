// Linear depth, from 0 at the light's near plane to 1 at its far plane, of a window depth.
float shadow_linear_depth(float depth) {
    if (depth >= 1.0) {
        return 1.0;
    }
    return clamp((shadow_distance(depth) - SHADOW_NEAR) / (SHADOW_FAR - SHADOW_NEAR), 0.0, 1.0);
}

// The moments of a texel of the map, whose layers have no margin; beyond a layer, those of depth 1.
vec4 shadow_moments_in(sampler2D map, int layer, ivec2 texel) {
    return shadow_moments(shadow_linear_depth(shadow_stored(map, layer, texel)));
}

// The first pass: moments of the map's depths, blurred along its rows.
//
// map: the shadow map's window depths
// texel: of the pass's target, counted from the lower left one, which is (0, 0). The target has as many rows as the map,
//     and SHADOW_BLUR_MARGIN more columns on each side.
vec4 shadow_blur_rows(sampler2D map, ivec2 texel) {
    int height = shadow_layer_size(map).y;
    int layer = texel.y / height;
    int first = texel.x - SHADOW_BLUR_MARGIN - SHADOW_BLUR_TEXELS / 2;
    vec4 sum = vec4(0.0, 0.0, 0.0, 0.0);
    for (int i = 0; i < SHADOW_BLUR_TEXELS; i++) {
        sum += SHADOW_BLUR[i] * shadow_moments_in(map, layer, ivec2(first + i, texel.y % height));
    }
    return sum;
}

// The second pass: the first pass's target, blurred along its columns.
//
// rows: the first pass's target
// texel: of this pass's target, which has SHADOW_BLUR_MARGIN more rows below and above each layer
vec4 shadow_blur_columns(ShadowTexture rows, ivec2 texel) {
    int height = shadow_texture_size(rows).y / SHADOW_LAYERS;
    int wide = height + 2 * SHADOW_BLUR_MARGIN;
    int layer = texel.y / wide;
    int first = texel.y % wide - SHADOW_BLUR_MARGIN - SHADOW_BLUR_TEXELS / 2;
    vec4 sum = vec4(0.0, 0.0, 0.0, 0.0);
    for (int i = 0; i < SHADOW_BLUR_TEXELS; i++) {
        vec4 each = shadow_moments(1.0);
        int row = first + i;
        if (row >= 0 && row < height) {
            each = shadow_texel(rows, ivec2(texel.x, layer * height + row));
        }
        sum += SHADOW_BLUR[i] * each;
    }
    return sum;
}

// The blurred moments at a place in texels, interpolated.
vec4 shadow_blurred(ShadowTexture moments, int layer, vec2 place) {
    ivec2 size = shadow_texture_size(moments);
    int height = size.y / SHADOW_LAYERS;
    float margin = float(SHADOW_BLUR_MARGIN) - 0.5;
    vec2 at = clamp(place + vec2(margin, margin), vec2(0.0, 0.0), vec2(float(size.x - 1), float(height - 1)));
    vec2 corner = min(floor(at), vec2(float(size.x - 2), float(height - 2)));
    vec2 t = at - corner;
    ivec2 first = ivec2(corner) + ivec2(0, layer * height);
    vec4 below = shadow_texel(moments, first) * (1.0 - t.x) + shadow_texel(moments, first + ivec2(1, 0)) * t.x;
    vec4 above = shadow_texel(moments, first + ivec2(0, 1)) * (1.0 - t.x) + shadow_texel(moments, first + ivec2(1, 1)) * t.x;
    return below * (1.0 - t.y) + above * t.y;
}

float shadow_filter(SHADOW_MAPS, ShadowLookup at) {
    float bound = shadow_bound(shadow_blurred(moments, at.layer, at.texel), shadow_linear_depth(at.depth));
    return (bound - SHADOW_LIGHT_BLEEDING) / (1.0 - SHADOW_LIGHT_BLEEDING);
}
