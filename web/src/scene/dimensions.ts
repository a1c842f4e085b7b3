// The rig in metres and radians, with what is known of it and what is only drawn so. x forward, y up, z to the drone's
// right and to the viewer; the desk is y = 0.

/** The paper's section 2.1: 100 x 30 x 40 cm, and a stroke of 80 cm. */
export const LENGTH = 1.0;
export const DEPTH = 0.3;
export const RAIL_STOP = 0.4;

/** `pitch_stop` of twodof.rig.parameters: there the drone meets the rod. */
export const PITCH_STOP = 0.87;

/** From the bearing to a rotor pair, along the body: `arm` of twodof.rig.parameters. */
export const ARM = 0.1;

/** Zero of the range sensor: signals.RAIL_CENTRE. */
export const RANGE_FROM = -0.5;

// No publication has these: drawn so that the whole is 40 cm high, the propellers stay within the depth and the drone
// clears the bars at its stop.
export const PROFILE = 0.02;
export const BAR_RADIUS = 0.005;
export const BAR_HEIGHT = 0.1;
export const BAR_SIDE = 0.075;
export const CART_HALF = 0.05;
export const BEARING_HEIGHT = 0.265;
export const SUPPORT_SIDE = 0.142;
export const ROTOR_SIDE = 0.066;
export const ROTOR_RADIUS = 0.06;
export const ROTOR_HEIGHT = 0.022;
export const BODY_HALF = 0.045;

export const FULL_THRUST = 0.17;
