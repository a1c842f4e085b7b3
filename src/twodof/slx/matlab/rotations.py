"""Functions of MathWorks' toolboxes on rotations and quaternions, in MATLAB's language.

A quaternion is a row [w x y z], and a product of two is Hamilton's. Angles turn about the axes of a sequence, each
about an axis that the turns before it have moved. Source: reference pages of Aerospace and Robotics System Toolbox.
"""

ROTATIONS = {
    "eul2rotm": """
    function R = eul2rotm(e, seq)
    if nargin < 2, seq = 'ZYX'; end
    R = turned(seq(1), e(1)) * turned(seq(2), e(2)) * turned(seq(3), e(3));
    end
    function R = turned(axis, angle)
    k = mod(axis, 32) - 23; i = mod(k, 3) + 1; j = mod(i, 3) + 1;
    R = eye(3); R(i, i) = cos(angle); R(j, j) = cos(angle); R(j, i) = sin(angle); R(i, j) = -sin(angle);
    end""",
    "rotm2eul": """
    function e = rotm2eul(R, seq)
    if nargin < 2, seq = 'ZYX'; end
    switch seq
      case {'ZYX', 'zyx'}
        flat = hypot(R(1, 1), R(2, 1));
        e = [atan2(R(2, 1), R(1, 1)), atan2(-R(3, 1), flat), atan2(R(3, 2), R(3, 3))];
        if flat < 10 * eps, e(1) = 0; e(3) = atan2(-R(2, 3), R(2, 2)); end
      case {'XYZ', 'xyz'}
        flat = hypot(R(3, 3), R(2, 3));
        e = [atan2(-R(2, 3), R(3, 3)), atan2(R(1, 3), flat), atan2(-R(1, 2), R(1, 1))];
        if flat < 10 * eps, e(1) = 0; e(3) = atan2(R(2, 1), R(2, 2)); end
      otherwise
        e = rotm2eul_of_another_sequence(R);
    end""",
    "eul2quat": """
    function q = eul2quat(e, seq)
    if nargin < 2, seq = 'ZYX'; end
    q = [1 0 0 0];
    for n = 1:3
      r = [cos(e(n) / 2) 0 0 0]; r(mod(seq(n), 32) - 22) = sin(e(n) / 2);
      if n == 1, q = r; else, q = quatmultiply(q, r); end
    end""",
    "quat2eul": """
    function e = quat2eul(q, seq)
    if nargin > 1 && ~strcmp(seq, 'ZYX'), q = quat2eul_of_another_sequence(q); end
    q = quatnormalize(q); w = q(1); x = q(2); y = q(3); z = q(4);
    e = [atan2(2 * (x * y + w * z), w^2 + x^2 - y^2 - z^2), asin(min(max(-2 * (x * z - w * y), -1), 1)), ...
         atan2(2 * (y * z + w * x), w^2 - x^2 - y^2 + z^2)];
    """,
    "quat2rotm": """
    function R = quat2rotm(q)
    q = quatnormalize(q); w = q(1); x = q(2); y = q(3); z = q(4);
    R = [1 - 2 * (y^2 + z^2), 2 * (x * y - w * z), 2 * (x * z + w * y);
         2 * (x * y + w * z), 1 - 2 * (x^2 + z^2), 2 * (y * z - w * x);
         2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x^2 + y^2)];
    """,
    "quatmultiply": """
    function p = quatmultiply(q, r)
    if nargin < 2, r = q; end
    p = [q(:, 1) .* r(:, 1) - q(:, 2) .* r(:, 2) - q(:, 3) .* r(:, 3) - q(:, 4) .* r(:, 4), ...
         q(:, 1) .* r(:, 2) + q(:, 2) .* r(:, 1) + q(:, 3) .* r(:, 4) - q(:, 4) .* r(:, 3), ...
         q(:, 1) .* r(:, 3) - q(:, 2) .* r(:, 4) + q(:, 3) .* r(:, 1) + q(:, 4) .* r(:, 2), ...
         q(:, 1) .* r(:, 4) + q(:, 2) .* r(:, 3) - q(:, 3) .* r(:, 2) + q(:, 4) .* r(:, 1)];
    """,
    "quatconj": "function p = quatconj(q)\np = [q(:, 1), -q(:, 2:4)];",
    "quatnorm": "function n = quatnorm(q)\nn = sum(q .^ 2, 2);",
    "quatmod": "function n = quatmod(q)\nn = sqrt(sum(q .^ 2, 2));",
    "quatnormalize": "function p = quatnormalize(q)\np = q ./ sqrt(sum(q .^ 2, 2));",
    "quatinv": "function p = quatinv(q)\np = [q(:, 1), -q(:, 2:4)] ./ sum(q .^ 2, 2);",
    "quatrotate": "function r = quatrotate(q, v)\nr = v * quat2rotm(q);",
    "quat2dcm": "function C = quat2dcm(q)\nC = quat2rotm(q)';",
    "angle2dcm": """
    function C = angle2dcm(a, b, c, seq)
    if nargin < 4, seq = 'ZYX'; end
    C = eul2rotm([a, b, c], seq)';
    """,
    "angle2quat": """
    function q = angle2quat(a, b, c, seq)
    if nargin < 4, seq = 'ZYX'; end
    q = eul2quat([a, b, c], seq);
    """,
}  # fmt: skip
"""Code of each function by its name."""
