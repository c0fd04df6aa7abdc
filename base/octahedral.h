/* octahedral.h - unit vectors as two 16-bit numbers (mean error 0.0013 degrees).
 * Source: Meyer, Suessmuth, Sussner, Stamminger, Greiner, "On Floating-Point Normal Vectors",
 * EGSR 2010; survey in Cigolle et al., "A Survey of Efficient Representations for Independent Unit
 * Vectors", JCGT 3(2), 2014. */
#ifndef BSQ_OCTAHEDRAL_H
#define BSQ_OCTAHEDRAL_H

#include <stdint.h>
#include "base/vec.h"

/* Packs a unit vector: x coordinate of the unfolded octahedron in the low 16 bits, y in the high,
 * each a signed normalised integer in [-32767, 32767] stored in two's complement. */
uint32_t bsq_oct_pack(struct bsq_vec3 unit);
/* Unpacks to a vector of length 1 within float rounding. Any 32-bit value is valid. */
struct bsq_vec3 bsq_oct_unpack(uint32_t packed);

#endif
