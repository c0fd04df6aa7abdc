/* vdb_program.h - the memory of the program bisque-vdb, which its caller reserves; private to this
 * folder. */
#ifndef FMT_GRID_VDB_PROGRAM_H
#define FMT_GRID_VDB_PROGRAM_H

/* Bytes that OpenVDB takes for nodes of vectors and of bits, with malloc's overhead. vdb_program.cc
 * checks them. */
enum {
    VDB_VECTOR_LEAF = 128 + 512 * 12,
    VDB_VECTOR_LOWER = 66608,
    VDB_VECTOR_UPPER = 532624,
    VDB_BIT_LEAF = 112,
    VDB_BIT_LOWER = 33840,
    VDB_BIT_UPPER = 270480
};

#endif
