// What the files of normalized cross-correlation share; they are built as one program, in the order
// ncc_common, ncc_templates, ncc_score (CPUs) or ncc_group (GPUs), ncc_peaks.
//   C(x) = (s3 - s2 s4) / sqrt((s1 - s2^2) (s5 - s4^2)),   w: weights of sum 1
//   s1 = sum w t^2, s2 = sum w t, s3 = sum w S t, s4 = sum w S, s5 = sum w S^2
// The template is kept as t' = w (t - s2) / sqrt(s1 - s2^2), whose sum is zero but for rounding, so
// that C = (sum t' S - (sum t') s4) / sqrt(s5 - s4^2): one inner product per candidate.
// Options: TW, TH template size (odd); WEIGHTS_X, WEIGHTS_Y its comma-separated 1-d weights, each of
// sum 1 (w is their product); UNIFORM if they are all equal; FLOAT_IMAGE if pixels are floats, else
// they are 8-bit; INTEGER for 16-bit integer numerators (8-bit, UNIFORM); LANES 32-bit numbers per vector (4, 8, 16);
// ROWS candidate rows per register tile; PIECE_W, PIECE_H candidates of a piece at most.
// Layout: images row-major, pitch = width, readable 512 bytes past the end. A stored template is
// STORED floats: t' as TH rows of TEMPLATE_PITCH, zero past TW; then `sum` and `factor` with which
// C = factor (numerator - sum s4) / sigma, sum NAN if the template has no variance; then the taps of
// the numerator, TH rows of UNITS: floats t', or words of two 16-bit integers.

#define HALF_W (TW / 2)
#define HALF_H (TH / 2)
#define AREA (TW * TH)
#define TEMPLATE_PITCH (((TW + LANES - 1) / LANES) * LANES)
#define TEMPLATE_SIZE (TH * TEMPLATE_PITCH)
#define SUM_AT TEMPLATE_SIZE
#define FACTOR_AT (TEMPLATE_SIZE + 1)
#define TAPS_AT (TEMPLATE_SIZE + 2)
#define STORED (TAPS_AT + TH * UNITS)
#define NO_SCORE -2.0f
#define MAX_PEAKS 4

#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#define floatv JOIN(float, LANES)
#define intv JOIN(int, LANES)
#define uintv JOIN(uint, LANES)
#define ulongv JOIN(ulong, LANES)
#define VLOAD(p) JOIN(vload, LANES)(0, p)
#define VSTORE(v, p) JOIN(vstore, LANES)(v, 0, p)
#define TO_FLOAT(v) JOIN(convert_float, LANES)(v)
#define TO_INT(v) JOIN(convert_int, LANES)(v)
#define TO_UINT(v) JOIN(convert_uint, LANES)(v)
#define TO_ULONG(v) JOIN(convert_ulong, LANES)(v)

// ZIP_LOW, ZIP_HIGH: a0 b0 a1 b1 ... of the lower and of the upper halves of two vectors.
inline float sum_lanes4(float4 v) { return (v.x + v.y) + (v.z + v.w); }
#if LANES == 16
#define LANE_INDEX ((int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15))
#define ZIP_HALF(a, b)                                                                            \
  ((float16)(a.s0, b.s0, a.s1, b.s1, a.s2, b.s2, a.s3, b.s3, a.s4, b.s4, a.s5, b.s5, a.s6, b.s6, \
             a.s7, b.s7))
#define SUM_LANES(v) sum_lanes16(v)
inline float sum_lanes16(float16 v) { return sum_lanes4((v.s0123 + v.s4567) + (v.s89ab + v.scdef)); }
#elif LANES == 8
#define LANE_INDEX ((int8)(0, 1, 2, 3, 4, 5, 6, 7))
#define ZIP_HALF(a, b) ((float8)(a.s0, b.s0, a.s1, b.s1, a.s2, b.s2, a.s3, b.s3))
#define SUM_LANES(v) sum_lanes8(v)
inline float sum_lanes8(float8 v) { return sum_lanes4(v.s0123 + v.s4567); }
#else
#define LANE_INDEX ((int4)(0, 1, 2, 3))
#define ZIP_HALF(a, b) ((float4)(a.s0, b.s0, a.s1, b.s1))
#define SUM_LANES(v) sum_lanes4(v)
#endif
#define ZIP_LOW(a, b) ZIP_HALF((a).lo, (b).lo)
#define ZIP_HIGH(a, b) ZIP_HALF((a).hi, (b).hi)

#ifdef FLOAT_IMAGE
#define PIXEL float
#else
#define PIXEL uchar
#endif

// Sums of products of neighbouring 16-bit integers, as a lane of 32 bits holds two.
#if defined(__AVX512BW__) && LANES == 16
#define MULTIPLY_PAIRS(a, b) __builtin_ia32_pmaddwd512(SHORTS(a), SHORTS(b))
#elif defined(__AVX2__) && LANES == 8
#define MULTIPLY_PAIRS(a, b) __builtin_ia32_pmaddwd256(SHORTS(a), SHORTS(b))
#elif defined(__SSE2__) && LANES == 4
#define MULTIPLY_PAIRS(a, b) __builtin_ia32_pmaddwd128(SHORTS(a), SHORTS(b))
#endif
#ifdef MULTIPLY_PAIRS
typedef short shorts_t __attribute__((ext_vector_type(2 * LANES)));
#define SHORTS(v) __builtin_astype(v, shorts_t)
#else
inline intv multiply_pairs(intv a, intv b) {
  return ((a << 16) >> 16) * ((b << 16) >> 16) + (a >> 16) * (b >> 16);
}
#define MULTIPLY_PAIRS(a, b) multiply_pairs(a, b)
#endif

// Whole vectors at any address. Where memory allows it a vector is moved in one piece: drivers cut
// vload() and vstore() to pieces.
#if defined(__x86_64__)
typedef intv intv_anywhere __attribute__((aligned(2)));
typedef floatv floatv_anywhere __attribute__((aligned(4)));
typedef JOIN(short, LANES) shortv_anywhere __attribute__((aligned(2)));
#define LOAD_PAIRS(p) (*(const intv_anywhere*)(p))
#define STORE_SHORTS(v, p) *(shortv_anywhere*)(p) = JOIN(convert_short, LANES)(v)
#define STORE_FLOATS(space, v, p) *(space floatv_anywhere*)(p) = (v)
#else
// Of 16-bit numbers that are not negative.
inline intv load_pairs(const short* p) {
  int pairs[LANES];
  for (int k = 0; k < LANES; ++k) pairs[k] = p[2 * k] | (p[2 * k + 1] << 16);
  return VLOAD(pairs);
}
#define LOAD_PAIRS(p) load_pairs(p)
#define STORE_SHORTS(v, p) VSTORE(JOIN(convert_short, LANES)(v), p)
#define STORE_FLOATS(space, v, p) VSTORE(v, p)
#endif

#define PAIRS_X ((TW + 1) / 2)
#ifdef INTEGER
#define UNITS PAIRS_X
#else
#define UNITS TW
#endif

// Sums over a footprint are exact in integers.
#if defined(UNIFORM) && !defined(FLOAT_IMAGE)
#define EXACT_BOX 1  // integer sums
#else
#define EXACT_BOX 0
#endif

// What sums are taken relative to, so that they stay small: the middle one of three pixels of the
// first footprint, `first`, since one may be an outlier or not a number.
inline float finite_or_zero(float v) { return isfinite(v) ? v : 0.0f; }
inline float pick_origin(__global const PIXEL* first, int width) {
  const float a = finite_or_zero((float)first[0]),
              b = finite_or_zero((float)first[(size_t)HALF_H * width + HALF_W]),
              c = finite_or_zero((float)first[(size_t)(TH - 1) * width + TW - 1]);
  return fmax(fmin(a, b), fmin(fmax(a, b), c));
}

// Footprints of less variance have no score.
#define MIN_WEIGHTED_VARIANCE 0.1f  // grey^2, of 8-bit images with weights
#define MIN_RELATIVE_VARIANCE 1e-10f  // of the mean squared, of float images
#define MIN_VARIANCE 1e-30f
// A variance of this share of the mean squared, as the difference of two sums, is not exact to 1e-4;
// one below minus the other share is no rounding.
#define LOST_DIGITS 1e-2f
#define LEAST_DIGITS 1e-5f

typedef struct {
  int reference_x, reference_y;  // pixel left above the template's centre
  float fraction_x, fraction_y;
  float warp[4];
  int x, y, width, height;   // candidates in the target
  int flat;                  // bit 0: maxima along x only, bit 1: along y only
  int first_piece, pieces;   // row by row
} Job;

// Candidates [x, x + width) x [y, y + height) of a job, counted from the job's first.
typedef struct {
  int job, x, y, width, height;
} Piece;

// The best strict maxima of a piece, in falling order, among equals the first of the job first.
typedef struct {
  float best;  // largest coefficient, maximum or not
  int count;
  int place[MAX_PEAKS];  // y * job.width + x
  float around[MAX_PEAKS][9];
} Maxima;

typedef struct {
  float x, y, score, cxx, cxy, cyy;
} Peak;

typedef struct {
  int count;
  Peak peaks[MAX_PEAKS];
  float best_raw;
} Result;

__constant float kWeightsX[TEMPLATE_PITCH] = {WEIGHTS_X};
__constant float kWeightsY[TH] = {WEIGHTS_Y};

// Catmull-Rom weights of the samples at -1, 0, 1, 2 for the place f in [0, 1).
#define CUBIC0(f) (0.5f * (f) * (-1.0f + (f) * (2.0f - (f))))
#define CUBIC1(f) (0.5f * (2.0f + (f) * (f) * (-5.0f + 3.0f * (f))))
#define CUBIC2(f) (0.5f * (f) * (1.0f + (f) * (4.0f - 3.0f * (f))))
#define CUBIC3(f) (0.5f * (f) * (f) * ((f) - 1.0f))
inline float4 cubic_weights(float f) {
  return (float4)(CUBIC0(f), CUBIC1(f), CUBIC2(f), CUBIC3(f));
}

// Keeps the MAX_PEAKS largest values; among equals the first place.
inline int keep_best(float* value, int* place, int* source, int kept, float new_value,
                     int new_place, int new_source) {
  int i = min(kept, MAX_PEAKS);
  while (i > 0 &&
         (new_value > value[i - 1] || (new_value == value[i - 1] && new_place < place[i - 1])))
    --i;
  if (i == MAX_PEAKS) return kept;
  for (int k = min(kept, MAX_PEAKS - 1); k > i; --k) {
    value[k] = value[k - 1];
    place[k] = place[k - 1];
    source[k] = source[k - 1];
  }
  value[i] = new_value;
  place[i] = new_place;
  source[i] = new_source;
  return min(kept + 1, MAX_PEAKS);
}

// Maxima below this share of the best are not wanted.
inline float peak_threshold(float quality, float best) { return fmax(quality * best, -1.0f); }
