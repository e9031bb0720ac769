// Depth of one view by plane sweep over inverse depth, and its refinement on slanted planes.
//
// A reference pixel x at inverse depth r is seen by neighbour m at  x' ~ A_m (x, y, 1)' + b_m r.
// Per neighbour and plane, with weights w (separable Gaussian, sum 1) over the template:
//   s1 = sum w R^2, s2 = sum w R, s3 = sum w S R, s4 = sum w S, s5 = sum w S^2
//   C  = (s3 - s2 s4) / sqrt((s1 - s2^2) (s5 - s4^2))
// Fused score: mean of the C above MIN_SCORE if there are at least MIN_VIEWS of them (valid), else
// mean of all positive C (not valid, serves to interpolate peaks only).
//
// Memory: images are float, grey level - 128, row-major, PITCH elements per row of which PAD come
// before column 0; PITCH - PAD >= width + PAD. Neighbours' images lie one after the other.
// S is NaN wherever a pixel's ray leaves the neighbour or the reference ends, so every sum over a
// window that is not wholly seen becomes NaN, which is no score: comparisons with it are false.
//
// Build options: VEC (pixels of a row per work-item: 16 on CPUs, 1 on GPUs), RADIUS (template side
// 2 RADIUS + 1), WEIGHTS (comma-separated 1-d weights, sum 1), MIN_SCORE, MIN_VIEWS, MIN_VARIANCE
// (grey levels squared, below which a window has no texture), PAD (>= RADIUS, >= VEC).
// Launch: x >= groups of VEC pixels (width rounded up to 16), y >= rows, z as each kernel says.

#if VEC == 16
typedef float16 vfloat;
typedef int16 vint;
#define LOAD(p) vload16(0, (p))
#define STORE(v, p) vstore16((v), 0, (p))
#define TO_INT(v) convert_int16(v)
#define TO_FLOAT(v) convert_float16(v)
#define LOAD_CODE(p) convert_int16(vload16(0, (p)))
#define STORE_CODE(v, p) vstore16(convert_ushort16(v), 0, (p))
#define LANES ((float16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15))
#else
typedef float vfloat;
typedef int vint;
#define LOAD(p) (*(p))
#define STORE(v, p) (*(p) = (v))
#define TO_INT(v) convert_int(v)
#define TO_FLOAT(v) convert_float(v)
#define LOAD_CODE(p) convert_int(*(p))
#define STORE_CODE(v, p) (*(p) = convert_ushort(v))
#define LANES 0.0f
#endif

#define CODE_SCALE 16383.0f

// Tests plant a fault to see that they notice.
#ifdef CORVID_PLANT_FAULT
#define CENTRED 0.97f
#else
#define CENTRED 1.0f
#endif

constant float kWeights[2 * RADIUS + 1] = {WEIGHTS};

#if VEC == 16
inline vfloat gather(global const float* image, vint at) {
  int index[VEC];
  float value[VEC];
  vstore16(at, 0, index);
  for (int i = 0; i < VEC; ++i) value[i] = image[index[i]];
  return vload16(0, value);
}
#else
inline vfloat gather(global const float* image, vint at) { return image[at]; }
#endif

// Bilinear sample at (nx, ny) / nz; NaN outside the image or behind the camera.
inline vfloat sample(global const float* image, int width, int height, int pitch, vfloat nx,
                     vfloat ny, vfloat nz) {
  const vfloat scale = 1.0f / nz;
  const vfloat x = nx * scale, y = ny * scale;
  const vint inside = (nz > 0.0f) & (x >= 0.0f) & (y >= 0.0f) & (x <= (float)(width - 1)) &
                      (y <= (float)(height - 1));
  const vfloat xc = select((vfloat)(0.0f), x, inside), yc = select((vfloat)(0.0f), y, inside);
  // At the last column and row the upper neighbours weigh nothing: step back instead of over.
  const vint x0 = min(TO_INT(xc), (vint)(width - 2)), y0 = min(TO_INT(yc), (vint)(height - 2));
  const vfloat fx = xc - TO_FLOAT(x0), fy = yc - TO_FLOAT(y0);
  const vint at = y0 * pitch + x0 + PAD;
  const vfloat a = gather(image, at), b = gather(image, at + 1);
  const vfloat c = gather(image, at + pitch), d = gather(image, at + pitch + 1);
  const vfloat top = mad(b - a, fx, a), bottom = mad(d - c, fx, c);
  return select((vfloat)(NAN), mad(bottom - top, fy, top), inside);
}

// Fused score of up to any number of neighbours, one after the other.
typedef struct {
  vfloat sum_valid, valid, sum_seen, seen;
} Fusion;

inline void add_score(Fusion* f, vfloat score) {
  const vint is_valid = score > MIN_SCORE;
  const vint is_seen = score == score;
  f->sum_valid += select((vfloat)(0.0f), score, is_valid);
  f->valid += select((vfloat)(0.0f), (vfloat)(1.0f), is_valid);
  f->sum_seen += select((vfloat)(0.0f), fmax(score, (vfloat)(0.0f)), is_seen);
  f->seen += select((vfloat)(0.0f), (vfloat)(1.0f), is_seen);
}

inline vint enough_views(const Fusion* f) { return f->valid >= (float)(MIN_VIEWS); }

inline vfloat fused_score(const Fusion* f) {
  const vfloat mean_seen = f->sum_seen / fmax(f->seen, (vfloat)(1.0f));
  const vfloat mean_valid = f->sum_valid / fmax(f->valid, (vfloat)(1.0f));
  return fmin(select(mean_seen, mean_valid, enough_views(f)), (vfloat)(1.0f));
}

// C from its sums; NaN where a window has no texture or is not wholly seen.
inline vfloat correlation(vfloat s1, vfloat s2, vfloat s3, vfloat s4, vfloat s5) {
  const vfloat var_r = s1 - s2 * s2, var_s = s5 - s4 * s4;
  const vint textured = (var_r > MIN_VARIANCE) & (var_s > MIN_VARIANCE);
  const vfloat c = (s3 - CENTRED * s2 * s4) * rsqrt(var_r * var_s);
  return select((vfloat)(NAN), c, textured);
}

// One pixel per work-item: mean of scale x scale pixels of an 8-bit image, minus 128.
// z = 1; out is a padded image, its padding is filled beforehand.
kernel void shrink(global const uchar* image, int image_width, int scale, global float* out,
                   int width, int height, int pitch) {
  const int x = get_global_id(0), y = get_global_id(1);
  if (x >= width || y >= height) return;
  int sum = 0;
  for (int j = 0; j < scale; ++j) {
    for (int i = 0; i < scale; ++i) sum += image[(y * scale + j) * image_width + x * scale + i];
  }
  out[y * pitch + PAD + x] = (float)sum / (float)(scale * scale) - 128.0f;
}

// s1 and s2 of the reference, one pixel per work-item; NaN where the template leaves the image.
kernel void reference_sums(global const float* reference, int width, int height, int pitch,
                           int row, global float* s1, global float* s2) {
  const int x = get_global_id(0), y = get_global_id(1);
  if (x >= width || y >= height) return;
  float sum1 = NAN, sum2 = NAN;
  if (x >= RADIUS && y >= RADIUS && x < width - RADIUS && y < height - RADIUS) {
    sum1 = sum2 = 0.0f;
    for (int j = -RADIUS; j <= RADIUS; ++j) {
      for (int i = -RADIUS; i <= RADIUS; ++i) {
        const float r = reference[(y + j) * pitch + PAD + x + i];
        const float w = kWeights[j + RADIUS] * kWeights[i + RADIUS];
        sum1 = mad(w * r, r, sum1);
        sum2 = mad(w, r, sum2);
      }
    }
  }
  s1[y * row + x] = sum1;
  s2[y * row + x] = sum2;
}

// z = plane of the slice: neighbour (z % neighbours) at depth sample first + z / neighbours.
// geometry: 12 floats per neighbour, A row by row, then b.
kernel void warp_planes(global const float* images, int neighbours, int width, int height,
                        int pitch, int row, global const float* geometry, float inverse_far,
                        float inverse_step, int first, global float* warped) {
  const int x0 = get_global_id(0) * VEC, y = get_global_id(1), plane = get_global_id(2);
  if (x0 >= row || y >= height) return;
  const int m = plane % neighbours;
  global const float* g = geometry + 12 * m;
  const float r = inverse_far + inverse_step * (float)(first + plane / neighbours);
  const vfloat x = (vfloat)((float)x0) + LANES;
  const float fy = (float)y;
  const vfloat nx = mad((vfloat)(g[0]), x, (vfloat)(g[1] * fy + g[2] + g[9] * r));
  const vfloat ny = mad((vfloat)(g[3]), x, (vfloat)(g[4] * fy + g[5] + g[10] * r));
  const vfloat nz = mad((vfloat)(g[6]), x, (vfloat)(g[7] * fy + g[8] + g[11] * r));
  vfloat s = sample(images + m * pitch * height, width, height, pitch, nx, ny, nz);
  s = select((vfloat)(NAN), s, x < (float)width);
  STORE(s, warped + (plane * height + y) * pitch + PAD + x0);
}

// Sums along rows: w S, w S^2, w S R. z = plane. `sums`: per plane 3 images of height + 2 RADIUS
// rows of `row` elements, of which the first and last RADIUS rows are NaN.
kernel void sum_rows(global const float* reference, global const float* warped, int height,
                     int pitch, int row, global float* sums) {
  const int x0 = get_global_id(0) * VEC, y = get_global_id(1), plane = get_global_id(2);
  if (x0 >= row || y >= height) return;
  global const float* s = warped + (plane * height + y) * pitch + PAD + x0 - RADIUS;
  global const float* r = reference + y * pitch + PAD + x0 - RADIUS;
  vfloat a = 0.0f, b = 0.0f, c = 0.0f;
#pragma unroll
  for (int i = 0; i <= 2 * RADIUS; ++i) {
    const vfloat v = LOAD(s + i);
    const vfloat wv = v * kWeights[i];
    a += wv;
    b = mad(wv, v, b);
    c = mad(wv, LOAD(r + i), c);
  }
  const int size = (height + 2 * RADIUS) * row;
  global float* out = sums + plane * 3 * size + (y + RADIUS) * row + x0;
  STORE(a, out);
  STORE(b, out + size);
  STORE(c, out + 2 * size);
}

// Sums along columns, scores, fusion. z = depth sample within the slice. `volume`: per depth
// sample an image of `row` elements per row; code = 2 * round(CODE_SCALE * score) + valid.
kernel void score_planes(global const float* sums, global const float* s1, global const float* s2,
                         int neighbours, int height, int row, int first, global ushort* volume) {
  const int x0 = get_global_id(0) * VEC, y = get_global_id(1), slice = get_global_id(2);
  if (x0 >= row || y >= height) return;
  const int size = (height + 2 * RADIUS) * row;
  const vfloat r1 = LOAD(s1 + y * row + x0), r2 = LOAD(s2 + y * row + x0);
  Fusion fusion = {0.0f, 0.0f, 0.0f, 0.0f};
  for (int m = 0; m < neighbours; ++m) {
    global const float* in = sums + (slice * neighbours + m) * 3 * size + y * row + x0;
    vfloat a = 0.0f, b = 0.0f, c = 0.0f;
#pragma unroll
    for (int i = 0; i <= 2 * RADIUS; ++i) {
      a = mad((vfloat)(kWeights[i]), LOAD(in + i * row), a);
      b = mad((vfloat)(kWeights[i]), LOAD(in + size + i * row), b);
      c = mad((vfloat)(kWeights[i]), LOAD(in + 2 * size + i * row), c);
    }
    add_score(&fusion, correlation(r1, r2, c, a, b));
  }
  const vint score = TO_INT(mad(fused_score(&fusion), (vfloat)(CODE_SCALE), (vfloat)(0.5f)));
  const vint valid = select((vint)(0), (vint)(1), enough_views(&fusion));
  STORE_CODE(score * 2 + valid, volume + ((first + slice) * height + y) * row + x0);
}

// Best valid interior peak over depth. z = 1. A valid sample at either end that is better than the
// best peak means that the depth lies outside the interval: no answer. inverse: inverse depth (by
// the parabola through the peak), 0 where there is none; score: at the peak; lead: how much higher
// the peak is than the best other one more than RIVAL_DISTANCE samples away. Padded images.
#define RIVAL_DISTANCE 3
kernel void find_peaks(global const ushort* volume, int samples, int height, int row, int pitch,
                       float inverse_far, float inverse_step, global float* inverse,
                       global float* score, global float* lead) {
  const int x0 = get_global_id(0) * VEC, y = get_global_id(1);
  if (x0 >= row || y >= height) return;
  global const ushort* in = volume + y * row + x0;
  const int step = height * row;
  const vint first = LOAD_CODE(in), last = LOAD_CODE(in + (samples - 1) * step);
  const vint end = max(select((vint)(0), first, (first & 1) > 0),
                       select((vint)(0), last, (last & 1) > 0));
  vint best = 0, best_at = -1, before = 0, after = 0;
  vint p = first, c = LOAD_CODE(in + step);
  for (int d = 1; d < samples - 1; ++d) {
    const vint n = LOAD_CODE(in + (d + 1) * step);
    const vint better = ((c & 1) > 0) & ((c >> 1) >= (p >> 1)) & ((c >> 1) > (n >> 1)) & (c > best);
    best = select(best, c, better);
    best_at = select(best_at, (vint)(d), better);
    before = select(before, p, better);
    after = select(after, n, better);
    p = c;
    c = n;
  }
  vint second = 0;
  p = first;
  c = LOAD_CODE(in + step);
  for (int d = 1; d < samples - 1; ++d) {
    const vint n = LOAD_CODE(in + (d + 1) * step);
    const vint is_rival = ((c & 1) > 0) & ((c >> 1) >= (p >> 1)) & ((c >> 1) > (n >> 1)) &
                          ((best_at - d > RIVAL_DISTANCE) | (d - best_at > RIVAL_DISTANCE)) &
                          (c > second);
    second = select(second, c, is_rival);
    p = c;
    c = n;
  }
  const vfloat fc = TO_FLOAT(best >> 1), fp = TO_FLOAT(before >> 1), fn = TO_FLOAT(after >> 1);
  const vfloat curvature = fp - 2.0f * fc + fn;  // < 0 at a strict peak
  const vfloat offset = 0.5f * (fp - fn) / select((vfloat)(-1.0f), curvature, curvature < 0.0f);
  const vint found = (best_at > 0) & (end <= best);
  const int at = y * pitch + PAD + x0;
  const vfloat r = mad((vfloat)(inverse_step), TO_FLOAT(best_at) + offset, (vfloat)(inverse_far));
  STORE(select((vfloat)(0.0f), r, found), inverse + at);
  STORE(select((vfloat)(0.0f), (fc - 0.25f * (fp - fn) * offset) / CODE_SCALE, found), score + at);
  STORE(select((vfloat)(1.0f), TO_FLOAT((best >> 1) - (second >> 1)) / CODE_SCALE, found), lead + at);
}

// One pass of refinement, z = 1. A plane is linear in inverse depth over the image:
//   r(x + i, y + j) = r0 + a i + b j,
// so a and b come from a least-squares fit to the answers around (25 of them, every other pixel,
// those within FIT_TOLERANCE depth samples of the middle one; the middle one's place is taken by the
// best-scored neighbour where it has no answer). Then three hypotheses r0 - h, r0, r0 + h on that
// plane are correlated over every other pixel of the template: the best valid one, by the parabola
// if it is the middle one, replaces the answer. Rays without an answer get one in this way.
// geometry: 12 floats per neighbour as above. step: inverse depth of one sample; h: in samples.
#define FIT_REACH 4
#define FIT_TOLERANCE 3.0f
#define FIT_MIN_ANSWERS 6
#define MAX_SLANT 0.5f  // change of inverse depth within the template, relative
kernel void refine(global const float* reference, global const float* images, int neighbours,
                   int width, int height, int pitch, int row, global const float* geometry, float step,
                   float h, global const float* inverse_in, global const float* score_in,
                   global float* inverse_out, global float* score_out) {
  const int x0 = get_global_id(0) * VEC, y = get_global_id(1);
  if (x0 >= row || y >= height) return;
  const int at = y * pitch + PAD + x0;
  const vfloat own = LOAD(inverse_in + at), own_score = LOAD(score_in + at);
  const int j_low = max(-FIT_REACH, -(y / 2 * 2)), j_high = min(FIT_REACH, (height - 1 - y) / 2 * 2);

  vfloat middle = own, middle_score = select((vfloat)(0.0f), (vfloat)(2.0f), own > 0.0f);
  for (int j = j_low; j <= j_high; j += 2) {
    for (int i = -FIT_REACH; i <= FIT_REACH; i += 2) {
      const vfloat s = LOAD(score_in + at + j * pitch + i);
      const vint better = s > middle_score;
      middle = select(middle, LOAD(inverse_in + at + j * pitch + i), better);
      middle_score = select(middle_score, s, better);
    }
  }
  vfloat n = 0.0f, sx = 0.0f, sy = 0.0f, sxx = 0.0f, sxy = 0.0f, syy = 0.0f;
  vfloat sr = 0.0f, sxr = 0.0f, syr = 0.0f;
  for (int j = j_low; j <= j_high; j += 2) {
    for (int i = -FIT_REACH; i <= FIT_REACH; i += 2) {
      const vfloat r = LOAD(inverse_in + at + j * pitch + i);
      const vfloat d = (r - middle) / step;
      const vint use = (r > 0.0f) & (fabs(d) < FIT_TOLERANCE);
      const vfloat w = select((vfloat)(0.0f), (vfloat)(1.0f), use);
      const float fi = (float)i, fj = (float)j;
      n += w;
      sx += w * fi;
      sy += w * fj;
      sxx += w * (fi * fi);
      sxy += w * (fi * fj);
      syy += w * (fj * fj);
      sr += w * d;
      sxr += w * d * fi;
      syr += w * d * fj;
    }
  }
  // Around the centroid; a little of the identity is added, so that few answers mean no slant.
  const vfloat count = fmax(n, (vfloat)(1.0f));
  const vfloat cxx = sxx - sx * sx / count + 8.0f, cyy = syy - sy * sy / count + 8.0f;
  const vfloat cxy = sxy - sx * sy / count;
  const vfloat cxr = sxr - sx * sr / count, cyr = syr - sy * sr / count;
  const vfloat det = cxx * cyy - cxy * cxy;
  vfloat a = (cxr * cyy - cyr * cxy) / det, b = (cyr * cxx - cxr * cxy) / det;
  const vfloat fit = (sr - a * sx - b * sy) / count;
  const vint enough = n >= (float)FIT_MIN_ANSWERS;
  a = select((vfloat)(0.0f), a * step, enough);
  b = select((vfloat)(0.0f), b * step, enough);
  const vint answered = own > 0.0f;
  const vfloat move = select(fit, clamp(fit, (vfloat)(-1.0f), (vfloat)(1.0f)), answered);
  const vfloat r0 = middle + select((vfloat)(0.0f), move * step, enough);
  const vint tried = (r0 > 0.0f) & (answered | enough);
  const vfloat slant = (fabs(a) + fabs(b)) * (float)RADIUS;
  const vfloat shrink = fmin((vfloat)(1.0f), MAX_SLANT * r0 / fmax(slant, (vfloat)(1e-20f)));
  a *= shrink;
  b *= shrink;

  // NaN where the template leaves the reference, so that such rays get no score below.
  const vfloat x = (vfloat)((float)x0) + LANES;
  // (A comparison of scalars is 1, of vectors -1: they do not mix.)
  const float whole_row = y >= RADIUS && y < height - RADIUS ? 0.0f : NAN;
  const vint whole = (x >= (float)RADIUS) & (x < (float)(width - RADIUS));
  const int row_low = max(-RADIUS, -y), row_high = min(RADIUS, height - 1 - y);
  vfloat s1 = select((vfloat)(NAN), (vfloat)(whole_row), whole & tried), s2 = s1;
  float norm = 0.0f;
  for (int j = -RADIUS; j <= RADIUS; j += 2) {
    if (j < row_low || j > row_high) continue;
    for (int i = -RADIUS; i <= RADIUS; i += 2) {
      const float w = kWeights[j + RADIUS] * kWeights[i + RADIUS];
      const vfloat r = LOAD(reference + at + j * pitch + i);
      norm += w;
      s1 = mad(w * r, r, s1);
      s2 = mad((vfloat)(w), r, s2);
    }
  }
  s1 /= norm;
  s2 /= norm;

#if VEC == 16
  if (!any(tried & whole)) {
#else
  if (!(tried & whole)) {
#endif
    STORE(own, inverse_out + at);
    STORE(own_score, score_out + at);
    return;
  }

  vfloat scores[3];
  vint valid[3];
  for (int k = 0; k < 3; ++k) {
    const vfloat r = r0 + (float)(k - 1) * h * step;
    Fusion fusion = {0.0f, 0.0f, 0.0f, 0.0f};
    for (int m = 0; m < neighbours; ++m) {
      global const float* g = geometry + 12 * m;
      global const float* image = images + m * pitch * height;
      const float fy = (float)y;
      const vfloat nx = mad((vfloat)(g[0]), x, mad((vfloat)(g[9]), r, (vfloat)(g[1] * fy + g[2])));
      const vfloat ny = mad((vfloat)(g[3]), x, mad((vfloat)(g[10]), r, (vfloat)(g[4] * fy + g[5])));
      const vfloat nz = mad((vfloat)(g[6]), x, mad((vfloat)(g[11]), r, (vfloat)(g[7] * fy + g[8])));
      const vfloat nx_i = g[0] + g[9] * a, ny_i = g[3] + g[10] * a, nz_i = g[6] + g[11] * a;
      const vfloat nx_j = g[1] + g[9] * b, ny_j = g[4] + g[10] * b, nz_j = g[7] + g[11] * b;
      vfloat s3 = 0.0f, s4 = 0.0f, s5 = 0.0f;
      for (int j = -RADIUS; j <= RADIUS; j += 2) {
        if (j < row_low || j > row_high) continue;
        for (int i = -RADIUS; i <= RADIUS; i += 2) {
          const float w = kWeights[j + RADIUS] * kWeights[i + RADIUS];
          const vfloat s = sample(image, width, height, pitch, nx + nx_i * (float)i + nx_j * (float)j,
                                  ny + ny_i * (float)i + ny_j * (float)j,
                                  nz + nz_i * (float)i + nz_j * (float)j);
          const vfloat ws = s * w;
          s3 = mad(ws, LOAD(reference + at + j * pitch + i), s3);
          s4 += ws;
          s5 = mad(ws, s, s5);
        }
      }
      add_score(&fusion, correlation(s1, s2, s3 / norm, s4 / norm, s5 / norm));
    }
    scores[k] = fused_score(&fusion);
    valid[k] = enough_views(&fusion) & (r > 0.0f);
  }

  const vfloat curvature = scores[0] - 2.0f * scores[1] + scores[2];
  const vint peak = valid[1] & (scores[1] >= scores[0]) & (scores[1] >= scores[2]) & (curvature < 0.0f);
  const vfloat offset =
      0.5f * (scores[0] - scores[2]) / select((vfloat)(-1.0f), curvature, curvature < 0.0f);
  const vint low = valid[0] & (scores[0] > scores[1]) & (scores[0] >= scores[2]);
  const vint high = valid[2] & (scores[2] > scores[1]) & (scores[2] > scores[0]);
  vfloat r = own, score = own_score;
  r = select(r, r0 + offset * h * step, peak);
  score = select(score, scores[1] - 0.25f * (scores[0] - scores[2]) * offset, peak);
  r = select(r, r0 - h * step, low);
  score = select(score, scores[0], low);
  r = select(r, r0 + h * step, high);
  score = select(score, scores[2], high);
  STORE(r, inverse_out + at);
  STORE(score, score_out + at);
}
