// The width that a box covers of a texel, counted from the texel with the box's lower edge.
float shadow_covered(float edge, float number) {
    float low = shadow_select(0.0, edge, number == 0.0);
    return clamp(edge + 2.0 * SHADOW_RADIUS - number, low, 1.0) - low;
}

float shadow_filter(SHADOW_MAPS, ShadowLookup at) {
    vec2 own = floor(at.texel);
    vec2 corner = at.texel - own - vec2(SHADOW_RADIUS, SHADOW_RADIUS);
    vec2 first = floor(corner);
    vec2 edge = corner - first;
    ivec2 texel = ivec2(own + first);
    float lit = 0.0;
    float area = 0.0;
    for (int j = 0; j < SHADOW_TEXELS; j++) {
        float height = shadow_covered(edge.y, float(j));
        for (int i = 0; i < SHADOW_TEXELS; i++) {
            float part = height * shadow_covered(edge.x, float(i));
            if (part > 0.0) {
                lit += part * shadow_compared(map, at, texel + ivec2(i, j));
                area += part;
            }
        }
    }
    return lit / area;
}
