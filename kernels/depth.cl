// Depth of one view by plane sweep over inverse depth, first at half resolution, then on surfaces.
//
// A reference pixel x at inverse depth r is seen by neighbour m at  x' ~ A_m (x, y, 1)' + b_m r.
// Per neighbour and layer, with weights w (separable Gaussian, sum 1) over the template:
//   s1 = sum w R^2, s2 = sum w R, s3 = sum w S R, s4 = sum w S, s5 = sum w S^2
//   C  = (s3 - s2 s4) / sqrt((s1 - s2^2) (s5 - s4^2))
// S is the neighbour as the layer shows it: pixel x is taken at inverse depth base(x) + offset.
// With base 0 a layer is a plane that faces the camera; with an estimate of the surface as base,
// every pixel of a template lies where the surface is, so slanted ground costs nothing and the sums
// stay separable. Fused score: mean of the C above MIN_SCORE if there are at least MIN_VIEWS of
// them (valid), else mean of all positive C (not valid, serves to interpolate peaks and to guess
// only).
//
// Memory: images are row-major, PITCH elements per row of which PAD come before column 0 and at
// least 2 PAD follow column `row` - 1; `row` is the width rounded up to PAD. Neighbours' images lie
// one after the other; an element is a quad: the grey levels of (x, y), (x + 1, y), (x, y + 1),
// (x + 1, y + 1) from the lowest byte up, so that a bilinear sample is one load.
// S is NaN wherever a ray leaves the neighbour and R is NaN outside the reference, so every sum
// over a window that is not wholly seen becomes NaN, which is no score: comparisons with it are
// false.
//
// Build options: VEC (pixels of a row per vector: 16 on CPUs, 1 on GPUs), RADIUS (template side
// 2 RADIUS + 1), MIN_SCORE, MIN_VIEWS, MIN_VARIANCE
// (grey levels squared, below which a window has no texture), PAD (>= RADIUS, >= VEC).
// Launch, but for `sweep`: x >= groups of VEC pixels, y >= rows.

#if VEC == 16
typedef float16 vfloat;
typedef int16 vint;
typedef uint16 vuint;
#define LOAD(p) vload16(0, (p))
#define STORE(v, p) vstore16((v), 0, (p))
#define TO_INT(v) convert_int16(v)
#define TO_FLOAT(v) convert_float16(v)
#define LOAD_CODE(p) convert_int16(vload16(0, (p)))
#define STORE_CODE(v, p) vstore16(convert_short16(v), 0, (p))
#define LANES ((float16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15))
#else
typedef float vfloat;
typedef int vint;
typedef uint vuint;
#define LOAD(p) (*(p))
#define STORE(v, p) (*(p) = (v))
#define TO_INT(v) convert_int(v)
#define TO_FLOAT(v) convert_float(v)
#define LOAD_CODE(p) convert_int(*(p))
#define STORE_CODE(v, p) (*(p) = convert_short(v))
#define LANES 0.0f
#endif

#define CODE_SCALE 16383.0f
#define NO_CODE (-32768)
#define SIDE (2 * RADIUS + 1)

// Tests plant a fault to see that they notice.
#ifdef CORVID_PLANT_FAULT
#define CENTRED 0.97f
#else
#define CENTRED 1.0f
#endif

#if VEC == 16
inline vuint gather(global const uint* image, vint at) {
  int index[VEC];
  uint value[VEC];
  vstore16(at, 0, index);
  for (int i = 0; i < VEC; ++i) value[i] = image[index[i]];
  return vload16(0, value);
}
#else
inline vuint gather(global const uint* image, vint at) { return image[at]; }
#endif

// To 2e-7, where v > 0 and normal. The processor's estimate of 14 bits and a step of Newton's take
// a fraction of the time of a division.
inline vfloat reciprocal(vfloat v) {
#if defined(__AVX512F__) && VEC == 16
  const vfloat y = __builtin_ia32_rcp14ps512_mask(v, (vfloat)(0.0f), (ushort)0xffff);
  return y * fma(-v, y, (vfloat)(2.0f));
#else
  return 1.0f / v;
#endif
}
inline vfloat inverse_root(vfloat v) {
#if defined(__AVX512F__) && VEC == 16
  const vfloat y = __builtin_ia32_rsqrt14ps512_mask(v, (vfloat)(0.0f), (ushort)0xffff);
  return y * fma(-0.5f * v * y, y, (vfloat)(1.5f));
#else
  return rsqrt(v);
#endif
}

typedef struct {
  int width, height, pitch;
} Size;

// Where a row of the reference is seen: (x, r) -> x'. geometry: A row by row, then b.
typedef struct {
  float x[3], x1[3], r[3];  // x' ~ x + x1 * column + r * inverse depth
} RowGeometry;

inline RowGeometry row_geometry(global const float* g, int y) {
  RowGeometry out;
  for (int i = 0; i < 3; ++i) {
    out.x[i] = mad(g[3 * i + 1], (float)y, g[3 * i + 2]);
    out.x1[i] = g[3 * i];
    out.r[i] = g[9 + i];
  }
  return out;
}

// Grey level - 128 where column x at inverse depth r is seen; NaN outside or behind the camera.
inline vfloat sample(global const uint* image, Size size, RowGeometry g, vfloat x, vfloat r) {
  const vfloat nx = mad((vfloat)(g.r[0]), r, mad((vfloat)(g.x1[0]), x, (vfloat)(g.x[0])));
  const vfloat ny = mad((vfloat)(g.r[1]), r, mad((vfloat)(g.x1[1]), x, (vfloat)(g.x[1])));
  const vfloat nz = mad((vfloat)(g.r[2]), r, mad((vfloat)(g.x1[2]), x, (vfloat)(g.x[2])));
  const vfloat scale = reciprocal(nz);
  const vfloat u = nx * scale, v = ny * scale;
  const vint inside = (nz > 1e-20f) & (u >= 0.0f) & (v >= 0.0f) & (u <= (float)(size.width - 1)) &
                      (v <= (float)(size.height - 1));
  const vfloat uc = select((vfloat)(0.0f), u, inside), vc = select((vfloat)(0.0f), v, inside);
  const vint u0 = TO_INT(uc), v0 = TO_INT(vc);
  const vfloat fu = uc - TO_FLOAT(u0), fv = vc - TO_FLOAT(v0);
  const vuint quad = gather(image, v0 * size.pitch + u0 + PAD);
  const vfloat a = TO_FLOAT(quad & 255u), b = TO_FLOAT((quad >> 8) & 255u);
  const vfloat c = TO_FLOAT((quad >> 16) & 255u), d = TO_FLOAT(quad >> 24);
  const vfloat top = mad(b - a, fu, a), bottom = mad(d - c, fu, c);
  return select((vfloat)(NAN), mad(bottom - top, fv, top) - 128.0f, inside);
}

// C from its sums as a code; NO_CODE where a window has no texture or is not wholly seen.
inline vint score_code(vfloat mean, vfloat inverse_deviation, vfloat s3, vfloat s4, vfloat s5) {
  const vfloat variance = mad(-s4, s4, s5);
  const vfloat c = (s3 - CENTRED * mean * s4) * inverse_deviation * inverse_root(variance);
  const vint scored = (variance > MIN_VARIANCE) & (c == c);
  const vfloat scaled = clamp(c, (vfloat)(-1.0f), (vfloat)(1.0f)) * CODE_SCALE;
  const vint code = TO_INT(scaled + select((vfloat)(-0.5f), (vfloat)(0.5f), scaled > 0.0f));
  return select((vint)(NO_CODE), code, scored);
}

// Mean of scale x scale pixels of an 8-bit image, rounded, as quads. One pixel per work-item.
inline uint block_mean(global const uchar* image, int image_width, int scale, int x, int y) {
  int sum = 0;
  for (int j = 0; j < scale; ++j) {
    for (int i = 0; i < scale; ++i) sum += image[(y * scale + j) * image_width + x * scale + i];
  }
  return (2 * sum + scale * scale) / (2 * scale * scale);
}
kernel void shrink(global const uchar* image, int image_width, int scale, global uint* quads,
                   int width, int height, int pitch) {
  const int x = get_global_id(0), y = get_global_id(1);
  if (x >= width || y >= height) return;
  const int x1 = min(x + 1, width - 1), y1 = min(y + 1, height - 1);
  quads[y * pitch + PAD + x] = block_mean(image, image_width, scale, x, y) |
                               block_mean(image, image_width, scale, x1, y) << 8 |
                               block_mean(image, image_width, scale, x, y1) << 16 |
                               block_mean(image, image_width, scale, x1, y1) << 24;
}

// Grey level - 128 of the reference; outside keeps the NaN that was there. One pixel per work-item.
kernel void reference_grey(global const uint* quads, int width, int height, int pitch,
                           global float* grey) {
  const int x = get_global_id(0), y = get_global_id(1);
  if (x >= width || y >= height) return;
  const int at = y * pitch + PAD + x;
  grey[at] = (float)(quads[at] & 255u) - 128.0f;
}

// Mean and 1 / deviation of the reference's windows; NaN where there is none. weights: SIDE
// one-dimensional ones, sum 1.
kernel void reference_sums(constant float* weights, global const float* grey, int width, int height,
                           int pitch, int row, global float* mean,
                           global float* inverse_deviation) {
  const int x0 = get_global_id(0) * VEC, y = get_global_id(1);
  if (x0 >= row || y < RADIUS || y >= height - RADIUS) return;
  const int at = y * pitch + PAD + x0;
  vfloat s1 = 0.0f, s2 = 0.0f;
  for (int j = -RADIUS; j <= RADIUS; ++j) {
    vfloat t1 = 0.0f, t2 = 0.0f;
    for (int i = -RADIUS; i <= RADIUS; ++i) {
      const vfloat r = LOAD(grey + at + j * pitch + i);
      const vfloat wr = r * weights[i + RADIUS];
      t1 = mad(wr, r, t1);
      t2 += wr;
    }
    s1 = mad((vfloat)(weights[j + RADIUS]), t1, s1);
    s2 = mad((vfloat)(weights[j + RADIUS]), t2, s2);
  }
  const vfloat variance = s1 - s2 * s2;
  const vint textured = variance > MIN_VARIANCE;
  STORE(s2, mean + at);
  STORE(select((vfloat)(NAN), inverse_root(variance), textured), inverse_deviation + at);
}

// Scores of the layers first ... first + count - 1: layer i has the offset inverse_0 + i * step.
// `volume`: row by row; in a row per layer and neighbour `row` codes. Rows nearer than RADIUS to
// the border are not written.
// Launch: x >= tiles of columns, y = neighbours * count, on GPUs z >= tiles of rows.
#if VEC == 16
#define STRIP 10  // vectors
#define HALO ((2 * RADIUS + VEC - 1) / VEC)
kernel void sweep(constant float* restrict weights, global const uint* restrict images,
                  global const float* restrict grey, global const float* restrict mean,
                  global const float* restrict inverse_deviation, int neighbours, int width,
                  int height, int pitch, int row, global const float* restrict geometry,
                  global const float* restrict base, float inverse_0, float step, int first,
                  int layers, global short* restrict volume) {
  const int x0 = get_global_id(0) * STRIP * VEC;
  if (x0 >= row) return;
  const int m = get_global_id(1) % neighbours, layer = first + get_global_id(1) / neighbours;
  const Size size = {width, height, pitch};
  const int vectors = min(STRIP, (row - x0) / VEC);
  const float offset = inverse_0 + step * (float)layer;
  float warped[(STRIP + HALO) * VEC];
  float sums[SIDE][3][STRIP * VEC];  // of the last SIDE rows: w S, w S^2, w S R along them
  int slot = 0;
  for (int y = 0; y < height; ++y) {
    const RowGeometry g = row_geometry(geometry + 12 * m, y);
    const int at = y * pitch + PAD + x0 - RADIUS;
    for (int v = 0; v < vectors + HALO; ++v) {
      const vfloat x = (vfloat)((float)(x0 - RADIUS + v * VEC)) + LANES;
      const vfloat r = LOAD(base + at + v * VEC) + offset;
      STORE(sample(images + m * pitch * height, size, g, x, r), warped + v * VEC);
    }
    for (int v = 0; v < vectors; ++v) {
      vfloat a = 0.0f, b = 0.0f, c = 0.0f;
#pragma unroll
      for (int i = 0; i < SIDE; ++i) {
        const vfloat s = LOAD(warped + v * VEC + i);
        const vfloat ws = s * weights[i];
        a += ws;
        b = mad(ws, s, b);
        c = mad(ws, LOAD(grey + at + v * VEC + i), c);
      }
      STORE(a, sums[slot][0] + v * VEC);
      STORE(b, sums[slot][1] + v * VEC);
      STORE(c, sums[slot][2] + v * VEC);
    }
    slot = slot + 1 == SIDE ? 0 : slot + 1;
    if (y < 2 * RADIUS) continue;
    const int middle = y - RADIUS;
    global short* out = volume + ((middle * layers + layer) * neighbours + m) * row + x0;
    for (int v = 0; v < vectors; ++v) {
      vfloat a = 0.0f, b = 0.0f, c = 0.0f;
      int j_slot = slot;
#pragma unroll
      for (int j = 0; j < SIDE; ++j) {
        a = mad((vfloat)(weights[j]), LOAD(sums[j_slot][0] + v * VEC), a);
        b = mad((vfloat)(weights[j]), LOAD(sums[j_slot][1] + v * VEC), b);
        c = mad((vfloat)(weights[j]), LOAD(sums[j_slot][2] + v * VEC), c);
        j_slot = j_slot + 1 == SIDE ? 0 : j_slot + 1;
      }
      const int at_middle = middle * pitch + PAD + x0 + v * VEC;
      STORE_CODE(score_code(LOAD(mean + at_middle), LOAD(inverse_deviation + at_middle), c, a, b),
                 out + v * VEC);
    }
  }
}
#else
// A work-group does a tile of TILE_X x TILE_Y pixels (its local size) of one layer and neighbour.
#define TILE_X 32
#define TILE_Y 8
#define WIDE (TILE_X + 2 * RADIUS)
#define HIGH (TILE_Y + 2 * RADIUS)
kernel void sweep(constant float* restrict weights, global const uint* restrict images,
                  global const float* restrict grey, global const float* restrict mean,
                  global const float* restrict inverse_deviation, int neighbours, int width,
                  int height, int pitch, int row, global const float* restrict geometry,
                  global const float* restrict base, float inverse_0, float step, int first,
                  int layers, global short* restrict volume) {
  local float warped[HIGH][WIDE], reference[HIGH][WIDE], sums[3][HIGH][TILE_X];
  const int lx = get_local_id(0), ly = get_local_id(1);
  const int x0 = get_group_id(0) * TILE_X, y0 = get_group_id(1) * TILE_Y;
  const int plane = get_global_id(2), m = plane % neighbours, layer = first + plane / neighbours;
  const Size size = {width, height, pitch};
  const float offset = inverse_0 + step * (float)layer;
  for (int i = ly * TILE_X + lx; i < WIDE * HIGH; i += TILE_X * TILE_Y) {
    const int x = x0 - RADIUS + i % WIDE, y = y0 - RADIUS + i / WIDE;
    float s = NAN, r = NAN;
    if (x >= 0 && y >= 0 && x < width && y < height) {
      const int at = y * pitch + PAD + x;
      s = sample(images + m * pitch * height, size, row_geometry(geometry + 12 * m, y), (float)x,
                 base[at] + offset);
      r = grey[at];
    }
    warped[i / WIDE][i % WIDE] = s;
    reference[i / WIDE][i % WIDE] = r;
  }
  barrier(CLK_LOCAL_MEM_FENCE);
  for (int j = ly; j < HIGH; j += TILE_Y) {
    float a = 0.0f, b = 0.0f, c = 0.0f;
    for (int i = 0; i < SIDE; ++i) {
      const float s = warped[j][lx + i], ws = s * weights[i];
      a += ws;
      b = mad(ws, s, b);
      c = mad(ws, reference[j][lx + i], c);
    }
    sums[0][j][lx] = a;
    sums[1][j][lx] = b;
    sums[2][j][lx] = c;
  }
  barrier(CLK_LOCAL_MEM_FENCE);
  const int x = x0 + lx, y = y0 + ly;
  if (x >= row || y < RADIUS || y >= height - RADIUS) return;
  float a = 0.0f, b = 0.0f, c = 0.0f;
  for (int j = 0; j < SIDE; ++j) {
    a = mad(weights[j], sums[0][ly + j][lx], a);
    b = mad(weights[j], sums[1][ly + j][lx], b);
    c = mad(weights[j], sums[2][ly + j][lx], c);
  }
  const int at = y * pitch + PAD + x;
  STORE_CODE(score_code(mean[at], inverse_deviation[at], c, a, b),
             volume + ((y * layers + layer) * neighbours + m) * row + x);
}
#endif

// The neighbours' scores of one layer, put together.
typedef struct {
  vfloat score;
  vint valid;
} Fused;

inline Fused fuse(global const short* codes, int neighbours, int row) {
  vint sum_valid = 0, valid = 0, sum_seen = 0, seen = 0;
  for (int m = 0; m < neighbours; ++m) {
    const vint code = LOAD_CODE(codes + m * row);
    const vint is_valid = code > (int)(MIN_SCORE * CODE_SCALE);
    const vint is_seen = code > NO_CODE;
    sum_valid += select((vint)(0), code, is_valid);
    valid += select((vint)(0), (vint)(1), is_valid);
    sum_seen += select((vint)(0), max(code, (vint)(0)), is_seen);
    seen += select((vint)(0), (vint)(1), is_seen);
  }
  Fused out;
  out.valid = valid >= MIN_VIEWS;
  const vint sum = select(sum_seen, sum_valid, out.valid), n = select(seen, valid, out.valid);
  out.score = TO_FLOAT(sum) / (TO_FLOAT(max(n, (vint)(1))) * CODE_SCALE);
  return out;
}

// The best layer so far that counts, with the scores beside it, and the highest that may not.
typedef struct {
  vfloat score, before, after, highest;
  vint at, highest_at;
} Best;

// Layer d, of which p, c, n are the one before, itself and the next; better: where it counts more.
void remember(Best* b, Fused p, Fused c, Fused n, vint better, int d) {
  b->score = select(b->score, c.score, better);
  b->at = select(b->at, (vint)(d), better);
  b->before = select(b->before, p.score, better);
  b->after = select(b->after, n.score, better);
  const vint higher = c.score > b->highest;
  b->highest = select(b->highest, c.score, higher);
  b->highest_at = select(b->highest_at, (vint)(d), higher);
}

// Layers from the best one to the peak of the parabola through it and those beside it; 0 where
// these are not lower.
vfloat to_peak(Best b, vint inner) {
  const vfloat curvature = b.before - 2.0f * b.score + b.after;
  const vint peak = inner & (curvature < 0.0f);
  return select((vfloat)(0.0f),
                0.5f * (b.before - b.after) / select((vfloat)(-1.0f), curvature, peak), peak);
}
vfloat peak_score(Best b, vfloat offset) { return b.score - 0.25f * (b.before - b.after) * offset; }

// Best valid interior peak over depth. A valid sample at either end that is better than the best
// peak means that the depth lies outside the interval: no answer. Images: inverse: inverse depth
// (by the parabola through the peak), 0 where there is none; score: at the peak; lead: how much
// higher the peak is than the best other one more than RIVAL_DISTANCE samples away; guess: inverse,
// or where there is none that of the highest score, valid or not.
#define RIVAL_DISTANCE 3
kernel void find_peaks(global const short* volume, int samples, int neighbours, int height, int row,
                       int pitch, float inverse_far, float inverse_step, global float* inverse,
                       global float* score, global float* lead, global float* guess) {
  const int x0 = get_global_id(0) * VEC, y = get_global_id(1);
  if (x0 >= row || y < RADIUS || y >= height - RADIUS) return;
  const int step = neighbours * row;
  global const short* in = volume + y * samples * step + x0;
  const Fused first = fuse(in, neighbours, row),
              last = fuse(in + (samples - 1) * step, neighbours, row);
  const vfloat end = fmax(select((vfloat)(0.0f), first.score, first.valid),
                          select((vfloat)(0.0f), last.score, last.valid));
  Best best = {0.0f, 0.0f, 0.0f, first.score, -1, 0};
  Fused p = first, c = fuse(in + step, neighbours, row);
  for (int d = 1; d < samples - 1; ++d) {
    const Fused n = fuse(in + (d + 1) * step, neighbours, row);
    const vint is_peak = c.valid & (c.score >= p.score) & (c.score > n.score);
    remember(&best, p, c, n, is_peak & (c.score > best.score), d);
    p = c;
    c = n;
  }
  vfloat second = 0.0f;
  p = first;
  c = fuse(in + step, neighbours, row);
  for (int d = 1; d < samples - 1; ++d) {
    const Fused n = fuse(in + (d + 1) * step, neighbours, row);
    const vint is_rival = c.valid & (c.score >= p.score) & (c.score > n.score) &
                          ((best.at - d > RIVAL_DISTANCE) | (d - best.at > RIVAL_DISTANCE)) &
                          (c.score > second);
    second = select(second, c.score, is_rival);
    p = c;
    c = n;
  }
  const vint found = (best.at > 0) & (end <= best.score);
  const vfloat offset = to_peak(best, found);
  const int at = y * pitch + PAD + x0;
  const vfloat r = mad((vfloat)(inverse_step), TO_FLOAT(best.at) + offset, (vfloat)(inverse_far));
  const vfloat r_highest =
      mad((vfloat)(inverse_step), TO_FLOAT(best.highest_at), (vfloat)(inverse_far));
  STORE(select((vfloat)(0.0f), r, found), inverse + at);
  STORE(select((vfloat)(0.0f), peak_score(best, offset), found), score + at);
  STORE(select((vfloat)(1.0f), best.score - second, found), lead + at);
  STORE(select(r_highest, r, found), guess + at);
}

// A plane is linear in inverse depth over the image: r(x + i, y + j) = r0 + a i + b j. Fits one to
// the answers around each pixel (49 of them, every other pixel, those within `tolerance` samples
// of the middle one; the middle one's place is taken by the best-scored neighbour where it has no
// answer). Where there are too few, the guess, without slant. step: inverse depth of one sample;
// support: how many answers lie on the plane.
#define FIT_REACH 6
#define FIT_MIN_ANSWERS 6
#define MAX_SLANT 0.5f  // change of inverse depth within the template, relative
kernel void fit_planes(int height, int pitch, int row, float step, float tolerance,
                       global const float* inverse, global const float* score,
                       global const float* guess, global float* surface, global float* slant_x,
                       global float* slant_y, global float* support) {
  const int x0 = get_global_id(0) * VEC, y = get_global_id(1);
  if (x0 >= row || y >= height) return;
  const int at = y * pitch + PAD + x0;
  const vfloat own = LOAD(inverse + at);
  const int j_low = max(-FIT_REACH, -(y / 2 * 2)),
            j_high = min(FIT_REACH, (height - 1 - y) / 2 * 2);

  vfloat middle = own, middle_score = select((vfloat)(0.0f), (vfloat)(2.0f), own > 0.0f);
  for (int j = j_low; j <= j_high; j += 2) {
    for (int i = -FIT_REACH; i <= FIT_REACH; i += 2) {
      const vfloat s = LOAD(score + at + j * pitch + i);
      const vint better = s > middle_score;
      middle = select(middle, LOAD(inverse + at + j * pitch + i), better);
      middle_score = select(middle_score, s, better);
    }
  }
  vfloat n = 0.0f, sx = 0.0f, sy = 0.0f, sxx = 0.0f, sxy = 0.0f, syy = 0.0f;
  vfloat sr = 0.0f, sxr = 0.0f, syr = 0.0f;
  const float per_step = 1.0f / step;
  for (int j = j_low; j <= j_high; j += 2) {
    for (int i = -FIT_REACH; i <= FIT_REACH; i += 2) {
      const vfloat r = LOAD(inverse + at + j * pitch + i);
      const vfloat d = (r - middle) * per_step;
      const vint use = (r > 0.0f) & (fabs(d) < tolerance);
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
  const vfloat move = select(fit, clamp(fit, (vfloat)(-1.0f), (vfloat)(1.0f)), own > 0.0f);
  const vfloat planar = middle + move * step;
  const vint slanted = enough & (planar > 0.0f);
  const vfloat alone = select(LOAD(guess + at), own, own > 0.0f);
  const vfloat r0 = select(alone, planar, slanted);
  a = select((vfloat)(0.0f), a * step, slanted);
  b = select((vfloat)(0.0f), b * step, slanted);
  const vfloat slant = (fabs(a) + fabs(b)) * (float)RADIUS;
  const vfloat shrink = fmin((vfloat)(1.0f), MAX_SLANT * r0 / fmax(slant, (vfloat)(1e-20f)));
  STORE(r0, surface + at);
  STORE(n, support + at);
  STORE(a * shrink, slant_x + at);
  STORE(b * shrink, slant_y + at);
}

// The surface of a view at twice the resolution (and its lead). One pixel per work-item.
kernel void expand(global const float* surface, global const float* slant_x,
                   global const float* slant_y, global const float* lead, int coarse_width,
                   int coarse_height, int coarse_pitch, int width, int height, int pitch,
                   global float* fine_surface, global float* fine_lead) {
  const int x = get_global_id(0), y = get_global_id(1);
  if (x >= width || y >= height) return;
  const int cx = min(x / 2, coarse_width - 1), cy = min(y / 2, coarse_height - 1);
  const int from = cy * coarse_pitch + PAD + cx;
  const float dx = 0.5f * ((float)x - 0.5f) - (float)cx, dy = 0.5f * ((float)y - 0.5f) - (float)cy;
  const float r = surface[from] + slant_x[from] * dx + slant_y[from] * dy;
  fine_surface[y * pitch + PAD + x] = fmax(r, 0.0f);
  fine_lead[y * pitch + PAD + x] = lead[from];
}

// Best valid layer of a few around a surface: by the parabola if it is not the first or the last.
// No answer where a layer beside it is as good: views from one place tell nothing of depth. guess:
// that of the highest score, valid or not.
kernel void pick(global const short* volume, int layers, int neighbours, int height, int row,
                 int pitch, float inverse_0, float inverse_step, global const float* surface,
                 global float* inverse, global float* score, global float* guess) {
  const int x0 = get_global_id(0) * VEC, y = get_global_id(1);
  if (x0 >= row || y < RADIUS || y >= height - RADIUS) return;
  const int step = neighbours * row;
  global const short* in = volume + y * layers * step + x0;
  Best best = {0.0f, 0.0f, 0.0f, -1.0f, -1, 0};
  Fused p = {-1.0f, 0}, c = fuse(in, neighbours, row);
  for (int d = 0; d < layers; ++d) {
    Fused n = {-1.0f, 0};
    if (d + 1 < layers) n = fuse(in + (d + 1) * step, neighbours, row);
    remember(&best, p, c, n, c.valid & (c.score > best.score), d);
    p = c;
    c = n;
  }
  const vint inner = (best.at > 0) & (best.at < layers - 1);
  const vint peak = inner & (best.before - 2.0f * best.score + best.after < 0.0f);
  const vfloat offset = to_peak(best, inner);
  const int at = y * pitch + PAD + x0;
  const vfloat r = LOAD(surface + at);
  const vfloat r_best = mad((vfloat)(inverse_step), TO_FLOAT(best.at) + offset, r + inverse_0);
  const vfloat r_highest = mad((vfloat)(inverse_step), TO_FLOAT(best.highest_at), r + inverse_0);
  const vint found =
      (best.at >= 0) & (peak | (best.score > fmax(best.before, best.after))) & (r_best > 0.0f);
  STORE(select((vfloat)(0.0f), r_best, found), inverse + at);
  STORE(select((vfloat)(0.0f), peak_score(best, offset), found), score + at);
  STORE(select(fmax(r_highest, (vfloat)(0.0f)), r_best, found), guess + at);
}

// The planes around each pixel, continued to it: the nearest and the farthest of them (49 of them,
// every other pixel), of those on which MIN_SUPPORT answers lie. Where there are none, the pixel's
// own.
#define SIDE_REACH 6
#define MIN_SUPPORT 24.0f
kernel void near_and_far(int height, int pitch, int row, global const float* surface,
                         global const float* slant_x, global const float* slant_y,
                         global const float* support, global float* near, global float* far) {
  const int x0 = get_global_id(0) * VEC, y = get_global_id(1);
  if (x0 >= row || y >= height) return;
  const int at = y * pitch + PAD + x0;
  const vfloat own = LOAD(surface + at);
  vfloat most = own, least = own;
  const int j_low = max(-SIDE_REACH, -(y / 2 * 2)),
            j_high = min(SIDE_REACH, (height - 1 - y) / 2 * 2);
  for (int j = j_low; j <= j_high; j += 2) {
    for (int i = -SIDE_REACH; i <= SIDE_REACH; i += 2) {
      const int q = at + j * pitch + i;
      const vfloat r =
          LOAD(surface + q) - LOAD(slant_x + q) * (float)i - LOAD(slant_y + q) * (float)j;
      const vint supported = (LOAD(support + q) >= MIN_SUPPORT) & (r > 0.0f);
      most = select(most, fmax(most, r), supported);
      least = select(least, fmin(least, r), supported);
    }
  }
  STORE(most, near + at);
  STORE(least, far + at);
}

// Where the surface is torn (near and far differ by more than TORN of the inverse
// depth and TORN_SAMPLES), which of the
// two sides a pixel belongs to by narrow templates: the better one, or none if they are nearly as
// good. Wide templates near an edge see both sides and tend to give the near one to all.
#define TORN 0.04f
#define TORN_SAMPLES 2.0f
#define MIN_LEAD 0.06f
kernel void choose_side(int height, int pitch, int row, float step, global const float* near,
                        global const float* far, global const float* near_inverse,
                        global const float* near_score, global const float* far_inverse,
                        global const float* far_score, global float* inverse, global float* score) {
  const int x0 = get_global_id(0) * VEC, y = get_global_id(1);
  if (x0 >= row || y >= height) return;
  const int at = y * pitch + PAD + x0;
  const vfloat n = LOAD(near_score + at), f = LOAD(far_score + at);
  const vint torn = LOAD(near + at) - LOAD(far + at) >
                    fmax(TORN * LOAD(near + at), (vfloat)(TORN_SAMPLES * step));
  const vint is_near = torn & (n > f + MIN_LEAD), is_far = torn & (f > n + MIN_LEAD);
  vfloat r = select(LOAD(inverse + at), (vfloat)(0.0f), torn);
  vfloat s = select(LOAD(score + at), (vfloat)(0.0f), torn);
  r = select(select(r, LOAD(near_inverse + at), is_near), LOAD(far_inverse + at), is_far);
  s = select(select(s, n, is_near), f, is_far);
  STORE(r, inverse + at);
  STORE(s, score + at);
}
