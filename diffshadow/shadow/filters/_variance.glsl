vec4 shadow_moments(float depth) {
    float z = depth - 0.5;
    return vec4(z, z * z, 0.0, 0.0);
}

float shadow_bound(vec4 moments, float receiver) {
    float variance = max(moments.y - moments.x * moments.x, SHADOW_LEAST_VARIANCE);
    return shadow_chebyshev(moments.x, variance, receiver - 0.5);
}
