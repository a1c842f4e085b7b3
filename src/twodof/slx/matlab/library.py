"""Functions of signals in MATLAB's language: of MATLAB itself, and of its toolboxes on rotations and quaternions.

Sums are from the left, and systems are solved by elimination with partial pivoting. `refused` says why a function is
not translated. A factor by Cholesky is NaN where the matrix is not positive definite, for which MATLAB stops. Sorting
is by merging exchanges (Knuth, vol. 3, 5.2.2, algorithm M).

A quaternion is a row [w x y z], and a product of two is Hamilton's. Angles turn about the axes of a sequence, each
about an axis that the turns before it have moved. Source: reference pages of Aerospace and Robotics System Toolbox.
"""

LIBRARY = {
    "mean": """
    function m = mean(v, varargin)
    if nargin < 2, total = sum(v); else, total = sum(v, varargin); end
    m = total / (numel(v) / numel(total));""",
    "cumsum": """
    function s = cumsum(v)
    if min(size(v)) > 1, refused('the cumulative sum of a matrix with signals is not translated'); end
    s = v;
    if ~isnumeric(v), s = double(v); end
    for k = 2:numel(v), s(k) = s(k - 1) + v(k); end""",
    "filter": """
    function y = filter(b, a, x)
    if numel(a) > 1 || min(size(x)) > 1, refused('a filter with poles or of a matrix is not translated'); end
    n = numel(x); y = 0 * x;
    for k = min(numel(b), n):-1:1, y(k:n) = y(k:n) + b(k) / a * x(1:n - k + 1); end""",
    "unique": """
    function [c, ia, ic] = unique(v)
    if any(isnan(v(:))), refused('unique of NaN is not translated'); end
    s = sort(v(:)); c = s(1); ic = zeros(numel(v), 1);
    for k = 2:numel(s), if s(k) ~= s(k - 1), c = [c; s(k)]; end, end
    ia = zeros(size(c));
    for k = numel(v):-1:1, ic(k) = sum(c < v(k)) + 1; ia(ic(k)) = k; end
    if size(v, 1) == 1, c = c'; end""",
    "accumarray": """
    function y = accumarray(at, v, whole, of)
    if min(size(at)) > 1 || (nargin > 2 && numel(whole) > 0), refused('accumarray of a size is not translated'); end
    y = zeros(max(at), 1);
    if numel(v) == 1, v = v * ones(size(at)); end
    if nargin < 4, of = @sum; end
    for k = 1:numel(y), if any(at == k), y(k) = of(v(at == k)); end, end""",
    "cross": """
    function c = cross(a, b)
    if numel(a) ~= 3 || numel(b) ~= 3, refused('cross takes vectors of 3'); end
    c = reshape([a(2) * b(3) - a(3) * b(2); a(3) * b(1) - a(1) * b(3); a(1) * b(2) - a(2) * b(1)], size(a));""",
    "norm": """
    function n = norm(v, kind)
    if nargin < 2, kind = 2; elseif strcmp(kind, 'fro'), kind = 2; v = v(:); end
    if min(size(v)) > 1 || (kind ~= 1 && kind ~= 2), refused('this norm of', v, 'signals is not translated'); end
    v = v(:);
    if kind == 1, n = sum(abs(v)); elseif numel(v) == 1, n = abs(v); else, n = sqrt(sum(v .* v)); end""",
    "chol": """
    function f = chol(a, half)
    n = size(a, 1); f = zeros(n);
    if n ~= size(a, 2) || n > 6, refused('the factor of', a, 'signals is not translated'); end
    for k = 1:n, for m = k:n
      left = a(k, m);
      for i = 1:k - 1, left = left - f(k, i) * f(m, i); end
      if m == k, f(k, k) = sqrt(left); else, f(m, k) = left / f(k, k); end
    end, end
    if nargin < 2 || ~strcmp(half, 'lower'), f = f'; end""",
    "det": """
    function d = det(a)
    if any(size(a) ~= size(a, 1)) || numel(a) > 9, refused('the determinant of', a, 'signals is not translated'); end
    if numel(a) == 1
      d = a;
    elseif numel(a) == 4
      d = a(1, 1) * a(2, 2) + (0 - a(1, 2) * a(2, 1));
    else
      d = a(1, 1) * minor(a, 2, 3) + (0 - a(1, 2) * minor(a, 1, 3)) + a(1, 3) * minor(a, 1, 2);
    end
    function d = minor(a, i, j)
    d = a(2, i) * a(3, j) + (0 - a(2, j) * a(3, i));""",
    "mldivide": """
    function x = mldivide(a, b)
    n = size(a, 1); r = double([a, b]);
    if size(a, 2) ~= n || n > 6, refused('a system of', a, 'with signals is not solved'); end
    for k = 1:n
      for m = k + 1:n
        if abs(r(m, k)) > abs(r(k, k)), r([k, m], :) = r([m, k], :); end
      end
      for m = k + 1:n, r(m, :) = r(m, :) - r(m, k) / r(k, k) * r(k, :); end
    end
    x = r(:, n + 1:end);
    for k = n:-1:1
      for m = k + 1:n, x(k, :) = x(k, :) - r(k, m) * x(m, :); end
      x(k, :) = x(k, :) / r(k, k);
    end""",
    "interp1": """
    function y = interp1(x, v, at)
    if numel(x) ~= numel(v) || numel(x) < 2 || any(x(2:end) <= x(1:end - 1))
      refused('interp1 is translated for constant places that increase');
    end
    y = at;
    for i = 1:numel(at)
      u = at(i); y(i) = NaN;
      for k = numel(x) - 1:-1:1
        if (u >= x(k)) & (u <= x(k + 1)), y(i) = v(k) + (v(k + 1) - v(k)) / (x(k + 1) - x(k)) * (u - x(k)); end
      end
    end""",
    "linspace": """
    function y = linspace(first, last, n)
    if nargin < 3, n = 100; end
    y = [first + (0:n - 2) * ((last - first) / (n - 1)), last];""",
    "inv": "function x = inv(a)\nx = a \\ eye(size(a, 1));",
    "linsolve": "function x = linsolve(a, b)\nx = a \\ b;",
    "sort": """
    function v = sort(v)
    if min(size(v)) > 1, refused('a matrix with signals is not sorted'); end
    n = numel(v); p = 1;
    while p < n
      step = p;
      while step >= 1
        for from = mod(step, p):2 * step:n - step - 1, for i = from + 1:from + min(step, n - from - step)
          if floor((i - 1) / (2 * p)) == floor((i - 1 + step) / (2 * p))
            low = min(v(i), v(i + step)); v(i + step) = max(v(i), v(i + step)); v(i) = low;
          end
        end, end
        step = floor(step / 2);
      end
      p = 2 * p;
    end""",
    "median": "function m = median(v)\nv = sort(v); n = numel(v); m = mean(v(floor((n + 1) / 2):floor(n / 2) + 1));",
    "trace": "function t = trace(a)\nt = sum(diag(a));",
    "real": "function y = real(x)\ny = x;",
    "isequal": """
    function y = isequal(a, b)
    if any(size(a) ~= size(b)), y = false; else, y = all(a(:) == b(:)); end""",
    "nnz": "function n = nnz(a)\nn = sum(a(:) ~= 0);",
    "dot": "function d = dot(a, b)\nd = a(:)' * b(:);",
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
         atan2(2 * (y * z + w * x), w^2 - x^2 - y^2 + z^2)];""",
    "quat2rotm": """
    function R = quat2rotm(q)
    q = quatnormalize(q); w = q(1); x = q(2); y = q(3); z = q(4);
    R = [1 - 2 * (y^2 + z^2), 2 * (x * y - w * z), 2 * (x * z + w * y);
         2 * (x * y + w * z), 1 - 2 * (x^2 + z^2), 2 * (y * z - w * x);
         2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x^2 + y^2)];""",
    "rotm2quat": """
    function q = rotm2quat(R)
    Q = [1 + R(1, 1) + R(2, 2) + R(3, 3), R(3, 2) - R(2, 3), R(1, 3) - R(3, 1), R(2, 1) - R(1, 2)
         R(3, 2) - R(2, 3), 1 + R(1, 1) - R(2, 2) - R(3, 3), R(1, 2) + R(2, 1), R(1, 3) + R(3, 1)
         R(1, 3) - R(3, 1), R(1, 2) + R(2, 1), 1 - R(1, 1) + R(2, 2) - R(3, 3), R(2, 3) + R(3, 2)
         R(2, 1) - R(1, 2), R(1, 3) + R(3, 1), R(2, 3) + R(3, 2), 1 - R(1, 1) - R(2, 2) + R(3, 3)];
    q = Q(1, :); m = Q(1, 1);
    for k = 2:4, if Q(k, k) > m, q = Q(k, :); m = Q(k, k); end, end
    q = q / norm(q);
    if q(1) < 0, q = -q; end""",
    "quatmultiply": """
    function p = quatmultiply(q, r)
    if nargin < 2, r = q; end
    p = [q(:, 1) .* r(:, 1) - q(:, 2) .* r(:, 2) - q(:, 3) .* r(:, 3) - q(:, 4) .* r(:, 4), ...
         q(:, 1) .* r(:, 2) + q(:, 2) .* r(:, 1) + q(:, 3) .* r(:, 4) - q(:, 4) .* r(:, 3), ...
         q(:, 1) .* r(:, 3) - q(:, 2) .* r(:, 4) + q(:, 3) .* r(:, 1) + q(:, 4) .* r(:, 2), ...
         q(:, 1) .* r(:, 4) + q(:, 2) .* r(:, 3) - q(:, 3) .* r(:, 2) + q(:, 4) .* r(:, 1)];""",
    "quatconj": "function p = quatconj(q)\np = [q(:, 1), -q(:, 2:4)];",
    "quatnorm": "function n = quatnorm(q)\nn = sum(q .^ 2, 2);",
    "quatmod": "function n = quatmod(q)\nn = sqrt(sum(q .^ 2, 2));",
    "quatnormalize": "function p = quatnormalize(q)\np = q ./ sqrt(sum(q .^ 2, 2));",
    "quatinv": "function p = quatinv(q)\np = [q(:, 1), -q(:, 2:4)] ./ sum(q .^ 2, 2);",
    "quatrotate": "function r = quatrotate(q, v)\nr = v * quat2rotm(q);",
    "quat2dcm": "function C = quat2dcm(q)\nC = quat2rotm(q)';",
    "angle2dcm": "function C = angle2dcm(a, b, c, seq)\nif nargin < 4, seq = 'ZYX'; end\nC = eul2rotm([a b c], seq)';",
    "angle2quat": "function q = angle2quat(a, b, c, seq)\nif nargin < 4, seq = 'ZYX'; end\nq = eul2quat([a b c], seq);",
}  # fmt: skip
"""Code of each function by its name."""
