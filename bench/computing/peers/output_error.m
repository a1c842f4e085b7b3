% Octave, packages control and optim: the output error fit of data.txt (u, y) from start.txt; writes octave.txt.
warning("off", "all");
pkg load control optim
data = load("data.txt"); start = load("start.txt")(:);
u = data(:, 1); y = data(:, 2);
model = @(u, p) filter([0, p(3), p(4)], [1, p(1), p(2)], u);
best = Inf;
for round = 1:5
  before = cputime();
  [~, p, converged, iterations, ~, covariance] = leasqr(u, y, start, model, 1e-9, 100);
  best = min(best, cputime() - before);
end
before = cputime();
states = moen4(iddata(y, u), 2, "noise", "none");
subspace = cputime() - before;
file = fopen("octave.txt", "w");
fprintf(file, "%.17g ", [p(:); sqrt(diag(covariance)); best; subspace]);
fclose(file);
