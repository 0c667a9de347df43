/* Loaded into the guest's kernel on processors with more state than that kernel knows (AMX: 11 KiB instead of 2.6).

User Mode Linux before 6.13 sets the registers of its processes with a buffer of fixed size, and since Linux 5.16 a host
refuses one that is shorter than all that its processor has: "ptrace set fp regs failed, errno = 14", and init is
killed. What the guest's kernel does not know is left as the process has it. */
#include <stdarg.h>
#include <string.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

enum { PEEK_FIRST = 1, PEEK_LAST = 3, GET_REGISTERS = 0x4204, SET_REGISTERS = 0x4205, EXTENDED_STATE = 0x202 };

long ptrace(int request, ...) {
    static unsigned char whole[1 << 16]; /* the stacks of the guest's kernel are small, and it has one thread */
    va_list given;
    va_start(given, request);
    int process = va_arg(given, int);
    void *address = va_arg(given, void *), *data = va_arg(given, void *);
    va_end(given);
    if (request >= PEEK_FIRST && request <= PEEK_LAST) {
        long word = 0;
        long status = syscall(SYS_ptrace, request, process, address, &word);
        return status < 0 ? status : word;
    }
    if (request == SET_REGISTERS && address == (void *)EXTENDED_STATE) {
        struct iovec *known = data, all = {whole, sizeof whole};
        if (syscall(SYS_ptrace, GET_REGISTERS, process, address, &all) == 0 && known->iov_len < all.iov_len) {
            memcpy(whole, known->iov_base, known->iov_len);
            return syscall(SYS_ptrace, SET_REGISTERS, process, address, &all);
        }
    }
    return syscall(SYS_ptrace, request, process, address, data);
}
