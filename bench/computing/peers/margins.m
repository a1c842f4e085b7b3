% Octave, package control: margin, isstable and Ms of the loops in loops.txt; writes octave.txt.
% A row of loops.txt: sample time (0: continuous), how many coefficients each, numerator, denominator, zeros to the end.
warning("off", "all");
pkg load control
rows = load("loops.txt");
found = zeros(size(rows, 1), 7);
before = cputime();
for k = 1:size(rows, 1)
  n = rows(k, 2); m = rows(k, 3);
  num = rows(k, 4:3+n); den = rows(k, 4+n:3+n+m);
  if (rows(k, 1) > 0) L = tf(num, den, rows(k, 1)); else L = tf(num, den); endif
  [gamma, phi, w_gamma, w_phi] = margin(L);
  closed = feedback(ss(L), 1);
  stable = isstable(closed);
  ms = Inf;
  if (stable) ms = norm(feedback(1, ss(L)), inf, 1e-9); endif
  found(k, :) = [gamma, phi, w_gamma, w_phi, stable, ms, 0];
endfor
found(:, 7) = (cputime() - before) / size(rows, 1);
file = fopen("octave.txt", "w");
fprintf(file, "%.17g ", found');
fclose(file);
