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

int MPI_Send(const void* b, int n, MPI_Datatype t, int to, int tag, MPI_Comm c)
{
  message(n, t);
  return PMPI_Send(b, n, t, to, tag, c);
}

int MPI_Isend(const void* b, int n, MPI_Datatype t, int to, int tag, MPI_Comm c, MPI_Request* r)
{
  message(n, t);
  return PMPI_Isend(b, n, t, to, tag, c, r);
}

int MPI_Issend(const void* b, int n, MPI_Datatype t, int to, int tag, MPI_Comm c, MPI_Request* r)
{
  message(n, t);
  return PMPI_Issend(b, n, t, to, tag, c, r);
}

int MPI_Sendrecv(const void* b, int n, MPI_Datatype t, int to, int tag, void* rb, int rn,
                 MPI_Datatype rt, int from, int rtag, MPI_Comm c, MPI_Status* s)
{
  message(n, t);
  return PMPI_Sendrecv(b, n, t, to, tag, rb, rn, rt, from, rtag, c, s);
}

// One message to each neighbour that gets something.
static void neighbours(const int n[], MPI_Datatype t, MPI_Comm c)
{
  int in = 0, out = 0, weighted = 0;
  PMPI_Dist_graph_neighbors_count(c, &in, &out, &weighted);
  for (int i = 0; i < out; ++i)
    if (n[i])
      message(n[i], t);
}

int MPI_Neighbor_alltoallv(const void* b, const int n[], const int d[], MPI_Datatype t, void* rb,
                           const int rn[], const int rd[], MPI_Datatype rt, MPI_Comm c)
{
  neighbours(n, t, c);
  return PMPI_Neighbor_alltoallv(b, n, d, t, rb, rn, rd, rt, c);
}

int MPI_Ineighbor_alltoallv(const void* b, const int n[], const int d[], MPI_Datatype t, void* rb,
                            const int rn[], const int rd[], MPI_Datatype rt, MPI_Comm c,
                            MPI_Request* r)
{
  neighbours(n, t, c);
  return PMPI_Ineighbor_alltoallv(b, n, d, t, rb, rn, rd, rt, c, r);
}

int MPI_Allreduce(const void* b, void* rb, int n, MPI_Datatype t, MPI_Op op, MPI_Comm c)
{
  collective(n, t);
  return PMPI_Allreduce(b, rb, n, t, op, c);
}

int MPI_Iallreduce(const void* b, void* rb, int n, MPI_Datatype t, MPI_Op op, MPI_Comm c,
                   MPI_Request* r)
{
  collective(n, t);
  return PMPI_Iallreduce(b, rb, n, t, op, c, r);
}

int MPI_Reduce(const void* b, void* rb, int n, MPI_Datatype t, MPI_Op op, int root, MPI_Comm c)
{
  collective(n, t);
  return PMPI_Reduce(b, rb, n, t, op, root, c);
}

int MPI_Bcast(void* b, int n, MPI_Datatype t, int root, MPI_Comm c)
{
  collective(n, t);
  return PMPI_Bcast(b, n, t, root, c);
}

int MPI_Allgather(const void* b, int n, MPI_Datatype t, void* rb, int rn, MPI_Datatype rt,
                  MPI_Comm c)
{
  collective(n, t);
  return PMPI_Allgather(b, n, t, rb, rn, rt, c);
}

int MPI_Allgatherv(const void* b, int n, MPI_Datatype t, void* rb, const int rn[], const int d[],
                   MPI_Datatype rt, MPI_Comm c)
{
  collective(n, t);
  return PMPI_Allgatherv(b, n, t, rb, rn, d, rt, c);
}

int MPI_Alltoall(const void* b, int n, MPI_Datatype t, void* rb, int rn, MPI_Datatype rt,
                 MPI_Comm c)
{
  int size = 0;
  PMPI_Comm_size(c, &size);
  collective((double)n * size, t);
  return PMPI_Alltoall(b, n, t, rb, rn, rt, c);
}

int MPI_Alltoallv(const void* b, const int n[], const int d[], MPI_Datatype t, void* rb,
                  const int rn[], const int rd[], MPI_Datatype rt, MPI_Comm c)
{
  int size = 0;
  double total = 0;
  PMPI_Comm_size(c, &size);
  for (int i = 0; i < size; ++i)
    total += n[i];
  collective(total, t);
  return PMPI_Alltoallv(b, n, d, t, rb, rn, rd, rt, c);
}

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
