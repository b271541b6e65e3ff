// Chebyshev's bound: how much of a distribution with this mean and variance is at the receiver or beyond.
float shadow_chebyshev(float mean, float variance, float receiver) {
    float behind = max(receiver - mean, 0.0);
    return variance / (variance + behind * behind);
}
