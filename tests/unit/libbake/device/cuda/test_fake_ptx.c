/* test_fake_ptx.c - the machine of the fake CUDA driver computes each instruction as PTX defines it
 * (NVIDIA, "PTX ISA", "Instruction Set"), and refuses what it does not know. */
#include <dlfcn.h>

#include "tests/fake/ptx.h"
#include "tests/unit/test.h"

static struct ptx *(*ptx_read_text)(const char *text, const char *name);
static bool (*ptx_run_kernel)(const struct ptx *ptx, struct ptx_launch *launch);
static void (*ptx_free_kernel)(struct ptx *ptx);

static int open_fake(void **state)
{
    char path[4096];
    ssize_t length = readlink("/proc/self/exe", path, sizeof path - 64);

    (void)state;
    assert_true(length > 0);
    path[length] = '\0';
    strcpy(strrchr(path, '/'), "/../fake/libcuda.so.1");
    void *fake = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    assert_non_null(fake);
    *(void **)&ptx_read_text = dlsym(fake, "ptx_read");
    *(void **)&ptx_run_kernel = dlsym(fake, "ptx_run");
    *(void **)&ptx_free_kernel = dlsym(fake, "ptx_free");
    assert_true(ptx_read_text && ptx_run_kernel && ptx_free_kernel);
    return 0;
}

/* Reads a kernel that has some instructions. %rd1 to %rd4 hold the inputs and %r1 to %r4 their
 * lower halves; the results are %rd0 and %r0. */
static struct ptx *read_kernel(const char *instructions)
{
    static const char head[] = ".visible .entry one(\n\t.param .u64 one_param_0\n)\n{\n"
                               "\t.reg .pred %p<4>;\n\t.reg .b16 %rs<4>;\n\t.reg .b32 %r<8>;\n"
                               "\t.reg .b64 %rd<8>;\n\tld.param.u64 %rd7, [one_param_0];\n"
                               "\tld.global.v4.u64 {%rd1, %rd2, %rd3, %rd4}, [%rd7];\n"
                               "\tld.global.u32 %r1, [%rd7];\n\tld.global.u32 %r2, [%rd7+8];\n"
                               "\tld.global.u32 %r3, [%rd7+16];\n\tld.global.u32 %r4, [%rd7+24];\n"
                               "\tmov.u64 %rd0, 0;\n\tmov.u32 %r0, 0;\n\t";
    static const char tail[] = ";\n\tst.global.u64 [%rd7+32], %rd0;\n"
                               "\tst.global.u32 [%rd7+40], %r0;\n\tret;\n}\n";
    char text[2048];

    snprintf(text, sizeof text, "%s%s%s", head, instructions, tail);
    return ptx_read_text(text, "one");
}

static uint64_t memory[32];

static void *find_memory(unsigned long long address, size_t bytes)
{
    return address + bytes <= sizeof memory ? (char *)memory + address : NULL;
}

/* Runs instructions in the first thread of a block. */
static void run(const char *instructions, const uint64_t inputs[4], uint64_t *wide, uint64_t *half)
{
    struct ptx *ptx = read_kernel(instructions);
    unsigned long long address = 0;
    void *parameters[] = {&address};
    struct ptx_launch launch = {.grid_x = 1,
                                .grid_y = 1,
                                .block_x = 1,
                                .block_y = 1,
                                .parameters = parameters,
                                .memory = find_memory};

    assert_non_null(ptx);
    memset(memory, 0, sizeof memory);
    memcpy(memory, inputs, 4 * sizeof *inputs);
    assert_true(ptx_run_kernel(ptx, &launch));
    *wide = memory[4];
    *half = memory[5];
    ptx_free_kernel(ptx);
}

/* Instructions that differ from known ones in a type, a modifier, a width or an operand. */
TEST(test_refused)
{
    static const char *const unknown[] = {"add.f32 %r0, %r1, %r2",
                                          "add.rz.f32 %r0, %r1, %r2",
                                          "add.rn.ftz.f32 %r0, %r1, %r2",
                                          "add.rn.sat.f32 %r0, %r1, %r2",
                                          "add.rn.f64 %rd0, %rd1, %rd2",
                                          "add.sat.s32 %r0, %r1, %r2",
                                          "add.s16 %rs0, %rs1, %rs2",
                                          "mul.f32 %r0, %r1, %r2",
                                          "mul.rn %r0, %r1, %r2",
                                          "mul24.lo.s32 %r0, %r1, %r2",
                                          "mad.wide.u32 %rd0, %r1, %r2, %rd3",
                                          "mad.hi.s32 %r0, %r1, %r2, %r3",
                                          "fma.rn.f32 %r0, %r1, %r2, %r3",
                                          "div.full.f32 %r0, %r1, %r2",
                                          "div.s32 %r0, %r1, %r2",
                                          "sqrt.approx.f32 %r0, %r1",
                                          "rcp.rn.ftz.f32 %r0, %r1",
                                          "min.NaN.f32 %r0, %r1, %r2",
                                          "max.ftz.f32 %r0, %r1, %r2",
                                          "and.u32 %r0, %r1, %r2",
                                          "shl.b16 %rs0, %rs1, %r2",
                                          "shl.s32 %r0, %r1, %r2",
                                          "bfe.b32 %r0, %r1, %r2, %r3",
                                          "bfi.u32 %r0, %r1, %r2, %r3, %r4",
                                          "popc.u32 %r0, %r1",
                                          "selp.b16 %rs0, %rs1, %rs2, %p1",
                                          "setp.eq.f64 %p1, %rd1, %rd2",
                                          "setp.lt.b32 %p1, %r1, %r2",
                                          "setp.ltu.s32 %p1, %r1, %r2",
                                          "setp.eq.and.s32 %p1, %r1, %r2, %p2",
                                          "setp.lt.ftz.f32 %p1, %r1, %r2",
                                          "cvt.u8.u32 %r0, %r1",
                                          "cvt.u32.u8 %r0, %r1",
                                          "cvt.rni.s32.f32 %r0, %r1",
                                          "cvt.rzi.u32.f32 %r0, %r1",
                                          "cvt.rn.ftz.f32.s32 %r0, %r1",
                                          "cvt.sat.u32.u64 %r0, %rd1",
                                          "ld.global.u8 %r0, [%rd1]",
                                          "ld.global.s8 %r0, [%rd1]",
                                          "ld.global.u16 %rs0, [%rd1]",
                                          "ld.volatile.global.u32 %r0, [%rd1]",
                                          "ld.u32 %r0, [%rd1]",
                                          "ld.shared.u32 %r0, [%rd1]",
                                          "ld.global.v3.u32 {%r0, %r1, %r2}, [%rd1]",
                                          "st.global.u8 [%rd1], %r0",
                                          "st.const.u32 [%rd1], %r0",
                                          "bar.sync 0",
                                          "call one",
                                          "ret.uni"};
    static const char *const wrong[] = {"add.s32 %r0, %rd1, %r2",
                                        "add.s64 %rd0, %rd1, %r2",
                                        "shl.b64 %rd0, %rd1, %rd2",
                                        "mul.wide.u32 %r0, %r1, %r2",
                                        "bfe.u32 %rd0, %r1, %r2, %r3",
                                        "popc.b32 %r0, %rd1",
                                        "cvt.u32.u64 %r0, %r1",
                                        "setp.eq.s32 %r0, %r1, %r2",
                                        "selp.b32 %r0, %r1, %r2, %r3",
                                        "add.s32 %r0, %r1",
                                        "add.s32 %r0, %r1, %r2, %r3",
                                        "mov.u32 5, %r1",
                                        "mov.u32 %r0, %r9",
                                        "mov.u32 %r0, nothing",
                                        "ld.global.f32 %rd0, [%rd1]",
                                        "ld.global.u32 %r0, [%r1]",
                                        "@%r1 ret",
                                        "bra nowhere"};

    (void)state;
    for (size_t i = 0; i < sizeof unknown / sizeof *unknown; i++)
        if (read_kernel(unknown[i]))
            fail_msg("%s is accepted", unknown[i]);
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++)
        if (read_kernel(wrong[i]))
            fail_msg("%s is accepted", wrong[i]);
}

#define INF  0x7f800000u
#define NAN_ 0x7fc00001u
#define ALL  0xffffffffu

TEST(test_computed)
{
    static const struct {
        const char *instructions;
        uint64_t inputs[4], result;
    } cases[] = {
        /* Extraction repeats the sign beyond the field and beyond the word. */
        {"bfe.s32 %r0, %r1, %r2, %r3", {0xf80, 7, 5}, ALL},
        {"bfe.s32 %r0, %r1, %r2, %r3", {0x780, 7, 5}, 0xf},
        {"bfe.s32 %r0, %r1, %r2, %r3", {0x80000000, 28, 8}, 0xfffffff8},
        {"bfe.s32 %r0, %r1, %r2, %r3", {0x80000000, 40, 8}, ALL},
        {"bfe.s32 %r0, %r1, %r2, %r3", {ALL, 3, 0}, 0},
        {"bfe.u32 %r0, %r1, %r2, %r3", {0xf80, 7, 5}, 0x1f},
        {"bfe.u32 %r0, %r1, %r2, %r3", {0x80000000, 28, 8}, 8},
        {"bfe.u32 %r0, %r1, %r2, %r3", {ALL, 40, 8}, 0},
        {"bfe.u32 %r0, %r1, %r2, %r3", {ALL, 0x104, 0x104}, 0xf},
        {"bfe.s64 %rd0, %rd1, %r2, %r3", {UINT64_C(1) << 40, 40, 1}, UINT64_MAX},
        {"bfe.u64 %rd0, %rd1, %r2, %r3", {UINT64_C(5) << 40, 40, 8}, 5},
        {"bfi.b32 %r0, %r1, %r2, %r3, %r4", {0xff, 0, 28, 8}, 0xf0000000},
        {"bfi.b32 %r0, %r1, %r2, %r3, %r4", {0, ALL, 4, 8}, 0xfffff00f},
        {"bfi.b64 %rd0, %rd1, %rd2, %r3, %r4", {ALL, 0, 40, 4}, UINT64_C(15) << 40},
        /* Shifts by the width or more. */
        {"shl.b32 %r0, %r1, %r2", {ALL, 32}, 0},
        {"shl.b32 %r0, %r1, %r2", {ALL, 31}, 0x80000000},
        {"shr.u32 %r0, %r1, %r2", {ALL, 32}, 0},
        {"shr.s32 %r0, %r1, %r2", {0x80000000, 40}, ALL},
        {"shr.s32 %r0, %r1, %r2", {0x7fffffff, 40}, 0},
        {"shr.u64 %rd0, %rd1, %r2", {UINT64_MAX, 63}, 1},
        {"shl.b64 %rd0, %rd1, %r2", {1, 64}, 0},
        /* Whole numbers. */
        {"add.s32 %r0, %r1, %r2", {ALL, 2}, 1},
        {"sub.s32 %r0, %r1, %r2", {1, 2}, ALL},
        {"add.s64 %rd0, %rd1, -1", {0}, UINT64_MAX},
        {"mul.lo.s32 %r0, %r1, %r2", {0x10001, 0x10001}, 0x20001},
        {"mad.lo.s32 %r0, %r1, %r2, %r3", {ALL, 2, 3}, 1},
        {"mul.wide.u32 %rd0, %r1, %r2", {ALL, ALL}, UINT64_C(0xfffffffe00000001)},
        {"mul.wide.s32 %rd0, %r1, %r2", {ALL, 2}, UINT64_MAX - 1},
        {"mul.hi.u32 %r0, %r1, %r2", {ALL, ALL}, 0xfffffffe},
        {"mul.hi.u64 %rd0, %rd1, %rd2", {UINT64_MAX, UINT64_MAX}, UINT64_MAX - 1},
        {"min.s32 %r0, %r1, %r2", {ALL, 1}, ALL},
        {"max.s32 %r0, %r1, %r2", {ALL, 1}, 1},
        {"min.u32 %r0, %r1, %r2", {ALL, 1}, 1},
        {"max.s64 %rd0, %rd1, %rd2", {UINT64_MAX, 1}, 1},
        {"neg.s32 %r0, %r1", {1}, ALL},
        {"not.b32 %r0, %r1", {0xf0}, 0xffffff0f},
        {"popc.b64 %r0, %rd1", {UINT64_MAX}, 64},
        {"popc.b32 %r0, %r1", {UINT64_MAX}, 32},
        {"xor.b64 %rd0, %rd1, %rd2", {UINT64_MAX, 1}, UINT64_MAX - 1},
        {"cvt.s32.s16 %r0, %r1", {0x12348000}, 0xffff8000},
        {"cvt.u32.u64 %r0, %rd1", {UINT64_C(0x1234567890)}, 0x34567890},
        {"cvt.u64.u32 %rd0, %r1", {ALL}, ALL},
        {"cvt.s64.s32 %rd0, %r1", {ALL}, UINT64_MAX},
        {"mov.u32 %r0, -1", {0}, ALL},
        /* Conversions of floats. */
        {"cvt.rzi.s32.f32 %r0, %r1", {0xbfc00000}, ALL},
        {"cvt.rzi.s32.f32 %r0, %r1", {0x4f32d05e}, 0x7fffffff},
        {"cvt.rzi.s32.f32 %r0, %r1", {INF | 0x80000000}, 0x80000000},
        {"cvt.rzi.s32.f32 %r0, %r1", {NAN_}, 0},
        {"cvt.rmi.f32.f32 %r0, %r1", {0xbfc00000}, 0xc0000000},
        {"cvt.rn.f32.s32 %r0, %r1", {16777217}, 0x4b800000},
        {"cvt.rn.f32.s32 %r0, %r1", {ALL}, 0xbf800000},
        {"cvt.rn.f32.u32 %r0, %r1", {ALL}, 0x4f800000},
        /* Floats: NaN has one form, zeros have signs, and denormals stay. */
        {"add.rn.f32 %r0, %r1, %r2", {INF, INF | 0x80000000}, 0x7fffffff},
        {"mul.rn.f32 %r0, %r1, %r2", {0x00800000, 0x3f000000}, 0x00400000},
        {"sub.rn.f32 %r0, %r1, %r2", {0x00800001, 0x00800000}, 1},
        {"div.rn.f32 %r0, %r1, %r2", {0x3f800000, 0x80000000}, INF | 0x80000000},
        {"rcp.rn.f32 %r0, %r1", {0x7f000000}, 0x00400000},
        {"sqrt.rn.f32 %r0, %r1", {0xbf800000}, 0x7fffffff},
        {"min.f32 %r0, %r1, %r2", {NAN_, 0x3f800000}, 0x3f800000},
        {"min.f32 %r0, %r1, %r2", {0, 0x80000000}, 0x80000000},
        {"max.f32 %r0, %r1, %r2", {0x80000000, 0}, 0},
        {"max.f32 %r0, %r1, %r2", {NAN_, NAN_}, 0x7fffffff},
        {"abs.f32 %r0, %r1", {0x80000000}, 0},
        {"neg.f32 %r0, %r1", {0}, 0x80000000},
        /* Relations: NaN is in no ordered one, also not in "ne". */
        {"setp.ne.f32 %p0, %r1, %r2;\nselp.u32 %r0, 1, 2, %p0", {NAN_, 0}, 2},
        {"setp.neu.f32 %p0, %r1, %r2;\nselp.u32 %r0, 1, 2, %p0", {NAN_, 0}, 1},
        {"setp.lt.f32 %p0, %r1, %r2;\nselp.u32 %r0, 1, 2, %p0", {NAN_, 0}, 2},
        {"setp.geu.f32 %p0, %r1, %r2;\nselp.u32 %r0, 1, 2, %p0", {0, NAN_}, 1},
        {"setp.eq.f32 %p0, %r1, %r2;\nselp.u32 %r0, 1, 2, %p0", {0, 0x80000000}, 1},
        {"setp.lt.s32 %p0, %r1, %r2;\nselp.u32 %r0, 1, 2, %p0", {ALL, 0}, 1},
        {"setp.lt.u32 %p0, %r1, %r2;\nselp.u32 %r0, 1, 2, %p0", {ALL, 0}, 2},
        {"setp.ge.u64 %p0, %rd1, %rd2;\nselp.b32 %r0, 1, 2, %p0", {UINT64_MAX, 1}, 1},
        {"setp.gt.s64 %p0, %rd1, %rd2;\nselp.b32 %r0, 1, 2, %p0", {UINT64_MAX, 1}, 2},
        {"setp.eq.s32 %p1, 1, 2;\nnot.pred %p0, %p1;\nselp.b32 %r0, 1, 2, %p0", {0}, 1},
        {"setp.eq.s32 %p1, 1, 2;\n@!%p1 mov.u32 %r0, 7;\n@%p1 mov.u32 %r0, 8", {0}, 7},
        /* Loads and stores. */
        {"ld.global.u32 %rd0, [%rd1+8]", {0, UINT64_MAX}, ALL},
        {"st.global.v2.u32 [%rd1+16], {%r2, %r3};\nld.global.u64 %rd0, [%rd1+16]",
         {0, 1, 2},
         UINT64_C(0x200000001)},
    };

    (void)state;
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        uint64_t wide, half;
        run(cases[i].instructions, cases[i].inputs, &wide, &half);
        if ((wide | half) != cases[i].result)
            fail_msg("%s of %#llx, %#llx: %#llx, not %#llx", cases[i].instructions,
                     (unsigned long long)cases[i].inputs[0], (unsigned long long)cases[i].inputs[1],
                     (unsigned long long)(wide | half), (unsigned long long)cases[i].result);
    }
}

/* Lines that differ only in what is not an instruction are refused too. */
TEST(test_declarations)
{
    static const char *const texts[] = {
        ".visible .entry two(\n\t.param .u64 two_param_0\n)\n{\n\tret;\n}\n",
        ".visible .entry one(\n\t.param .u64 one_param_0\n)\n{\n\t.reg .f64 %fd<3>;\n\tret;\n}\n",
        ".visible .entry one(\n\t.param .u64 one_param_0\n)\n{\n\t.reg .b8 %rc<3>;\n\tret;\n}\n"};

    (void)state;
    for (size_t i = 0; i < sizeof texts / sizeof *texts; i++)
        assert_null(ptx_read_text(texts[i], "one"));
}

RUN_TESTS(open_fake, NULL)
