// Distance along the light's axis, in world units, of a window depth.
float shadow_distance(float depth) {
    float d = clamp(depth, 0.0, 1.0);
    float span = SHADOW_FAR - SHADOW_NEAR;
    if (SHADOW_PERSPECTIVE) {
        return SHADOW_NEAR * SHADOW_FAR / (SHADOW_FAR - d * span);
    }
    return SHADOW_NEAR + d * span;
}
