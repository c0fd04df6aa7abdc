/* test_machine.c - limits of control groups, from files as systems and containers show them. */
#include <sys/stat.h>

#include "base/context_internal.h"
#include "tests/unit/test.h"

static const char root[] = "root";

/* Writes a file below the root, with the directories on its way. */
static void put(const char *path, const char *text)
{
    char name[512];
    snprintf(name, sizeof name, "%s/%s", root, path);
    for (char *slash = name + sizeof root; (slash = strchr(slash, '/')); *slash++ = '/') {
        *slash = '\0';
        mkdir(name, 0755);
    }
    test_text(name, text);
}

static int make_root(void **state)
{
    (void)state;
    return mkdir(root, 0755);
}

static int remove_root(void **state)
{
    (void)state;
    return system("rm -r root");
}
#define FIXTURE_TEST(name) TEST_EACH(name, make_root, remove_root)

static void expect(uint64_t memory_bytes, unsigned processors)
{
    struct bsq_machine machine = {.memory_bytes = 1 << 30, .processors = 64};
    bsq_apply_control_groups(root, &machine);
    assert_int_equal(machine.memory_bytes, memory_bytes);
    assert_int_equal(machine.processors, processors);
}

/* Mounts version 2 with the group `top` of the hierarchy at the usual place. */
static void mount_v2(const char *top)
{
    char line[256];
    snprintf(line, sizeof line,
             "22 1 8:1 / / rw - ext4 /dev/sda1 rw\n"
             "30 23 0:26 %s /sys/fs/cgroup rw,nosuid shared:4 - cgroup2 cgroup2 rw,nsdelegate\n",
             top);
    put("proc/self/mountinfo", line);
}

FIXTURE_TEST(test_without_control_groups)
{
    expect(1 << 30, 64);
    mount_v2("/");
    expect(1 << 30, 64);
    put("proc/self/cgroup", "0::/user.slice\n");
    expect(1 << 30, 64);
}

FIXTURE_TEST(test_tightest_ancestor)
{
    mount_v2("/");
    put("proc/self/cgroup", "0::/a/b/c\n");
    put("sys/fs/cgroup/a/b/c/memory.max", "max\n");
    put("sys/fs/cgroup/a/b/c/cpu.max", "max 100000\n");
    expect(1 << 30, 64);
    put("sys/fs/cgroup/a/b/memory.max", "300000000\n");
    put("sys/fs/cgroup/a/memory.max", "200000000\n");
    put("sys/fs/cgroup/a/cpu.max", "250000 100000\n");
    expect(200000000, 3);
    put("sys/fs/cgroup/a/b/c/memory.max", "100000000\n");
    put("sys/fs/cgroup/a/b/c/cpu.max", "1000 100000\n");
    expect(100000000, 1);
    put("sys/fs/cgroup/other/memory.max", "1\n");
    put("sys/fs/cgroup/a/b/c/d/memory.max", "1\n");
    expect(100000000, 1);
}

/* Above memory.high the kernel slows a group down and reclaims its memory. */
FIXTURE_TEST(test_memory_high)
{
    mount_v2("/");
    put("proc/self/cgroup", "0::/a\n");
    put("sys/fs/cgroup/a/memory.max", "300000000\n");
    put("sys/fs/cgroup/a/memory.high", "max\n");
    expect(300000000, 64);
    put("sys/fs/cgroup/a/memory.high", "150000000\n");
    expect(150000000, 64);
}

/* With a name space of its own a container sees its group as "/". */
FIXTURE_TEST(test_container_with_its_own_root)
{
    mount_v2("/");
    put("proc/self/cgroup", "0::/\n");
    put("sys/fs/cgroup/memory.max", "268435456\n");
    put("sys/fs/cgroup/cpu.max", "400000 100000\n");
    expect(268435456, 4);
}

/* Without one it sees its path on the host, of which only its own group is mounted. */
FIXTURE_TEST(test_container_with_the_path_of_the_host)
{
    mount_v2("/docker/0123");
    put("proc/self/cgroup", "0::/docker/0123/job\n");
    put("sys/fs/cgroup/memory.max", "268435456\n");
    put("sys/fs/cgroup/job/memory.max", "134217728\n");
    expect(134217728, 64);
    put("proc/self/cgroup", "0::/docker/0123\n");
    expect(268435456, 64);
    put("proc/self/cgroup", "0::/docker/01234/job\n"); /* another group: only the mount counts */
    expect(268435456, 64);
    put("proc/self/cgroup", "0::/../other\n");
    expect(268435456, 64);
}

FIXTURE_TEST(test_version_1)
{
    put("proc/self/mountinfo",
        "31 30 0:27 / /sys/fs/cgroup/memory rw - cgroup cgroup rw,memory\n"
        "32 30 0:28 / /sys/fs/cgroup/cpu,cpuacct rw - cgroup cgroup rw,cpu,cpuacct\n"
        "33 30 0:29 / /sys/fs/cgroup/unified rw - cgroup2 cgroup2 rw\n");
    put("proc/self/cgroup", "12:memory:/jobs/7\n4:cpu,cpuacct:/jobs\n1:name=systemd:/x\n0::/\n");
    put("sys/fs/cgroup/memory/memory.limit_in_bytes", "9223372036854771712\n");
    put("sys/fs/cgroup/cpu,cpuacct/cpu.cfs_quota_us", "-1\n");
    put("sys/fs/cgroup/cpu,cpuacct/cpu.cfs_period_us", "100000\n");
    expect(1 << 30, 64);
    put("sys/fs/cgroup/memory/jobs/memory.limit_in_bytes", "536870912\n");
    put("sys/fs/cgroup/memory/jobs/7/memory.limit_in_bytes", "600000000\n");
    put("sys/fs/cgroup/cpu,cpuacct/jobs/cpu.cfs_quota_us", "150000\n");
    put("sys/fs/cgroup/cpu,cpuacct/jobs/cpu.cfs_period_us", "50000\n");
    expect(536870912, 3);
}

FIXTURE_TEST(test_mount_with_a_blank)
{
    put("proc/self/mountinfo", "31 30 0:27 / /my\\040groups rw - cgroup2 none rw\n");
    put("proc/self/cgroup", "0::/a b\n");
    put("my groups/a b/memory.max", "1000\n");
    expect(1000, 64);
}

FIXTURE_TEST(test_damaged_files)
{
    put("proc/self/mountinfo", "\n - \n31 30\n31 30 0:27 / - cgroup2\n"
                               "31 30 0:27 / /sys/fs/cgroup rw - cgroup2 cgroup2 rw\n");
    put("proc/self/cgroup", "\n0\n0:\n0::\n0::a\n::::\n0::/a\n");
    put("sys/fs/cgroup/a/memory.max", "many\n");
    put("sys/fs/cgroup/a/memory.high", "-5\n");
    put("sys/fs/cgroup/a/cpu.max", "1 0\n");
    expect(1 << 30, 64);
}

RUN_TESTS(NULL, NULL)
