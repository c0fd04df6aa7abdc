/* device_list.c - a list of devices that grows. */
#include "libbake/device/backend/backend.h"

int bake_device_list_add(struct bsq_ctx *ctx, struct bake_device_list *list,
                         const struct bake_device_info *device)
{
    int status =
        bsq_grow(ctx, "devices", list->count + 1, sizeof *device, &list->devices, &list->capacity);

    if (status == 0)
        list->devices[list->count++] = *device;
    return status;
}

void bake_device_list_free(struct bsq_ctx *ctx, struct bake_device_list *list)
{
    bsq_free(ctx, list->devices);
    *list = (struct bake_device_list){0};
}
