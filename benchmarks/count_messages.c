// Counts what a rank sends: preload it, read the counters with nts_counts.
//
// mpicc -shared -fPIC -O2 -o libcount.so count_messages.c
#include <mpi.h>
#include <string.h>

// Messages to single ranks, collective calls; and their bytes.
static double counts[4];

void nts_counts(double* out) { memcpy(out, counts, sizeof counts); }

static double bytes_of(double n, MPI_Datatype type)
{
  int size = 0;
  PMPI_Type_size(type, &size);
  return n * size;
}

static void message(double n, MPI_Datatype type)
{
  counts[0] += 1;
  counts[1] += bytes_of(n, type);
}

static void collective(double n, MPI_Datatype type)
{
  counts[2] += 1;
  counts[3] += bytes_of(n, type);
}

// Requests that send the same again and again.
enum { MAX_PERSISTENT = 65536 };
static struct
{
  MPI_Request request;
  double bytes;
} persistent[MAX_PERSISTENT];
static int num_persistent;

static void started(MPI_Request request)
{
  for (int i = num_persistent - 1; i >= 0; --i)
    if (persistent[i].request == request)
    {
      counts[0] += 1;
      counts[1] += persistent[i].bytes;
      return;
    }
}

int MPI_Send_init(const void* b, int n, MPI_Datatype t, int to, int tag, MPI_Comm c, MPI_Request* r)
{
  int result = PMPI_Send_init(b, n, t, to, tag, c, r);
  if (num_persistent < MAX_PERSISTENT)
  {
    persistent[num_persistent].request = *r;
    persistent[num_persistent++].bytes = bytes_of(n, t);
  }
  return result;
}

// A handle that is freed can come back as that of another request.
int MPI_Request_free(MPI_Request* r)
{
  for (int i = 0; i < num_persistent; ++i)
    if (persistent[i].request == *r)
      persistent[i--] = persistent[--num_persistent];
  return PMPI_Request_free(r);
}

int MPI_Start(MPI_Request* r)
{
  started(*r);
  return PMPI_Start(r);
}

int MPI_Startall(int n, MPI_Request r[])
{
  for (int i = 0; i < n; ++i)
    started(r[i]);
  return PMPI_Startall(n, r);
}

#define COUNT int
#define DISPLACEMENT int
#define CALL(name) MPI_##name
#define PROFILED(name) PMPI_##name
#include "count_calls.h"

// The same with large counts, which mpi4py uses where there are any.
#if MPI_VERSION >= 4
#undef COUNT
#undef DISPLACEMENT
#undef CALL
#undef PROFILED
#define COUNT MPI_Count
#define DISPLACEMENT MPI_Aint
#define CALL(name) MPI_##name##_c
#define PROFILED(name) PMPI_##name##_c
#include "count_calls.h"
#endif

int MPI_Barrier(MPI_Comm c)
{
  collective(0, MPI_BYTE);
  return PMPI_Barrier(c);
}

int MPI_Ibarrier(MPI_Comm c, MPI_Request* r)
{
  collective(0, MPI_BYTE);
  return PMPI_Ibarrier(c, r);
}
