// The integral of a tent of radius 1 from 0 to u.
float shadow_tent_until(float u) {
    float x = clamp(u, -1.0, 1.0);
    return x - x * abs(x) / 2.0;
}

// The tent's weight between two places, measured from its peak in texels.
float shadow_tent(float low, float high) {
    return max(shadow_tent_until(high / SHADOW_RADIUS) - shadow_tent_until(low / SHADOW_RADIUS), 0.0);
}

float shadow_filter(SHADOW_MAPS, ShadowLookup at) {
    vec2 own = floor(at.texel);
    vec2 within = at.texel - own;
    vec2 first = floor(within - vec2(SHADOW_MAX_RADIUS, SHADOW_MAX_RADIUS));
    vec2 low = first - within;
    ivec2 texel = ivec2(own + first);
    float lit = 0.0;
    for (int j = 0; j < SHADOW_TEXELS; j++) {
        float row = shadow_tent(low.y + float(j), low.y + float(j) + 1.0);
        for (int i = 0; i < SHADOW_TEXELS; i++) {
            float part = row * shadow_tent(low.x + float(i), low.x + float(i) + 1.0);
            if (part > 0.0) {
                lit += part * shadow_compared(map, at, texel + ivec2(i, j));
            }
        }
    }
    return lit;
}
