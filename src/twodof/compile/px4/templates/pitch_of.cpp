/** The pitch of an attitude, with the sine kept in its range against rounding; NaN stays NaN. */
static float pitch_of(const float q[4])
{
    const float sine = 2.f * (q[0] * q[2] - q[3] * q[1]);
    return asinf(sine > 1.f ? 1.f : sine < -1.f ? -1.f : sine);
}

