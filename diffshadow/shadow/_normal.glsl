// The normal distribution's CDF, to 1e-7 (Abramowitz & Stegun 1964, 7.1.26).
float shadow_normal(float t) {
    float x = abs(t) * 0.707106781;
    float k = 1.0 / (1.0 + 0.3275911 * x);
    float tail = k * (0.254829592 + k * (-0.284496736 + k * (1.421413741 + k * (-1.453152027 + k * 1.061405429))));
    float beyond = 0.5 * tail * exp(-x * x);
    return shadow_select(1.0 - beyond, beyond, t < 0.0);
}
